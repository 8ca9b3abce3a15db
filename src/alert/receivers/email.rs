//! Mail by SMTP: text, and the same as HTML with pictures.

mod html;

use lettre::message::header::ContentType;
use lettre::message::header::{HeaderName, HeaderValue};
use lettre::message::{Attachment, Mailbox, Message as Mail, MultiPart, SinglePart};
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, Tls, TlsParameters};
use lettre::{AsyncSmtpTransport, AsyncTransport, Tokio1Executor};

use crate::alert::message::Message;
use crate::alert::receiver::{Receiver, SendError, Sending, Unusable};
use crate::alert::secret;
use armwatch_config::receivers::{EmailSettings, Encryption, ServerSettings};

/// Header for filters of mail programs.
const KEY_HEADER: &str = "X-Armwatch-Key";

/// Sends mails.
pub(super) struct Email {
    settings: EmailSettings,
    from: Mailbox,
    to: Vec<Mailbox>,
}

impl Email {
    pub(super) fn new(settings: &EmailSettings) -> Result<Self, Unusable> {
        let mailbox = |text: &String| {
            text.parse::<Mailbox>().map_err(|error| Unusable(format!("mail address {text}: {error}")))
        };
        let from = mailbox(&settings.from)?;
        let to = settings.to.iter().map(mailbox).collect::<Result<Vec<_>, _>>()?;
        if let Some((_, password)) = &settings.server.login {
            secret::read(password).map_err(Unusable)?;
        }
        let email = Self { settings: settings.clone(), from, to };
        email.encryption()?;
        Ok(email)
    }

    fn encryption(&self) -> Result<Tls, Unusable> {
        let unusable = |error: lettre::transport::smtp::Error| Unusable(format!("TLS: {error}"));
        if self.settings.server.encryption == Encryption::None {
            return Ok(Tls::None);
        }
        let mut parameters = TlsParameters::builder(self.settings.server.host.clone());
        if let Some(path) = &self.settings.server.ca_file {
            let pem = std::fs::read(path).map_err(|error| {
                Unusable(format!("{}: {error}; name a file of PEM certificates", path.display()))
            })?;
            parameters = parameters.add_root_certificate(Certificate::from_pem(&pem).map_err(unusable)?);
        }
        let parameters = parameters.build_rustls().map_err(unusable)?;
        Ok(match self.settings.server.encryption {
            Encryption::Tls => Tls::Wrapper(parameters),
            _ => Tls::Required(parameters),
        })
    }

    async fn mail(&self, message: &Message) -> Result<(), SendError> {
        let mail = self.write(message).map_err(SendError::refused)?;
        let tls = self.encryption().map_err(|error| SendError::unreached(error.to_string()))?;
        let ServerSettings { host, port, timeout, .. } = &self.settings.server;
        let mut transport = AsyncSmtpTransport::<Tokio1Executor>::builder_dangerous(host)
            .port(*port)
            .tls(tls)
            .timeout(Some(*timeout));
        if let Some((user, password)) = &self.settings.server.login {
            let password = secret::read(password).map_err(SendError::unreached)?;
            transport = transport.credentials(Credentials::new(user.clone(), password));
        }
        let transport = transport.build();
        let sent = tokio::time::timeout(*timeout, transport.send(mail)).await;
        let Ok(sent) = sent else {
            let seconds = timeout.as_secs_f64();
            return Err(SendError::unreached(format!("{host}:{port}: no answer within {seconds} s")));
        };
        sent.map(|_| ()).map_err(|error| {
            let detail = format!("{host}:{port}: {error}");
            // a permanent error may apply to this mail alone
            if error.is_permanent() { SendError::refused(detail) } else { SendError::unreached(detail) }
        })
    }

    fn write(&self, message: &Message) -> Result<Mail, String> {
        let domain = self.from.email.domain();
        let key = HeaderName::new_from_ascii_str(KEY_HEADER);
        let mut mail = Mail::builder()
            .from(self.from.clone())
            .subject(format!("[armwatch] {}", message.title()))
            .message_id(Some(format!("<{}@{domain}>", message.key)))
            .date_now()
            .raw_header(HeaderValue::new(key, message.key.clone()));
        // mails of one anomaly form one thread
        if let [alarm] = message.alarms.as_slice() {
            mail = mail.references(format!("<{}@{domain}>", message.origin.anomaly(alarm.event.anomaly_id)));
        }
        for to in &self.to {
            mail = mail.to(to.clone());
        }
        let (page, pictures) = html::page(message, domain);
        let png = ContentType::parse("image/png").map_err(|error| format!("mail: {error}"))?;
        let picture = |of: html::Picture| Attachment::new_inline(of.id).body(of.png, png.clone());
        let page = pictures
            .into_iter()
            .map(picture)
            .fold(MultiPart::related().singlepart(SinglePart::html(page)), MultiPart::singlepart);
        let parts = MultiPart::alternative().singlepart(SinglePart::plain(message.text())).multipart(page);
        mail.multipart(parts).map_err(|error| format!("mail: {error}"))
    }
}

impl Receiver for Email {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        Box::pin(self.mail(message))
    }
}
