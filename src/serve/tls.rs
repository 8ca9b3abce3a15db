//! TLS of the server's own, with a certificate that can be renewed while it runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};
use tokio_util::sync::CancellationToken;

use armwatch_config::{Config, TlsSettings};

/// Why a certificate or its key cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("serve.tls.{key} = {}: {detail}", .path.display())]
pub struct TlsError {
    key: &'static str,
    path: PathBuf,
    detail: String,
}

/// Reads certificate and key: TLS 1.2 or 1.3.
///
/// # Errors
/// [`TlsError`] names the file.
pub(super) fn acceptor(settings: &TlsSettings) -> Result<TlsAcceptor, TlsError> {
    let of_certificate = |detail: String| TlsError {
        key: "certificate",
        path: settings.certificate.clone(),
        detail: format!(
            "{detail}; name a PEM file with the certificate of this server, then those of its authorities"
        ),
    };
    let of_key = |detail: String| TlsError { key: "key", path: settings.key.clone(), detail };
    let chain =
        certificates(&settings.certificate).map_err(|error| of_certificate(said(&error, "certificate")))?;
    let key = PrivateKeyDer::from_pem_file(&settings.key).map_err(|error| {
        let detail = said(&error, "unencrypted private key");
        of_key(format!("{detail}; name a PEM file, such as one that `openssl pkey -in KEY -out NEW` writes"))
    })?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| of_certificate(error.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|error| match error {
            rustls::Error::InconsistentKeys(_) => of_key(format!(
                "the key is not that of the certificate in {}; name the two files that were issued together",
                settings.certificate.display()
            )),
            rustls::Error::InvalidCertificate(_) => of_certificate(error.to_string()),
            error => of_key(error.to_string()),
        })?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, pem::Error> {
    let chain: Vec<_> = CertificateDer::pem_file_iter(path)?.collect::<Result<_, _>>()?;
    if chain.is_empty() { Err(pem::Error::NoItemsFound) } else { Ok(chain) }
}

fn said(error: &pem::Error, wanted: &str) -> String {
    match error {
        pem::Error::NoItemsFound => format!("holds no {wanted}"),
        pem::Error::Io(error) => error.to_string(),
        error => format!("is no PEM file: {error}"),
    }
}

/// Reads the files again whenever the configuration is read again, until `stop`. Files that cannot be used change
/// nothing.
pub(super) async fn renew(
    settings: TlsSettings,
    mut config: watch::Receiver<Arc<Config>>,
    in_force: watch::Sender<TlsAcceptor>,
    stop: CancellationToken,
) {
    loop {
        let changed = tokio::select! {
            () = stop.cancelled() => return,
            changed = config.changed() => changed,
        };
        if changed.is_err() {
            return;
        }
        let settings = settings.clone();
        match tokio::task::spawn_blocking(move || acceptor(&settings)).await {
            Ok(Ok(renewed)) => {
                in_force.send_replace(renewed);
                tracing::info!("TLS certificate read again");
            }
            Ok(Err(error)) => tracing::error!(%error, "the earlier TLS certificate stays in force"),
            Err(error) => tracing::error!(%error, "the earlier TLS certificate stays in force"),
        }
    }
}
