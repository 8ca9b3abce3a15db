//! The client behind an address, for limits that hold per client.

use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;

use axum::http::HeaderMap;

/// One client: an IPv4 address, or an IPv6 network of 64 bits. An IPv4-mapped IPv6 address counts as its IPv4 address.
/// `::1` counts alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Network(IpAddr);

impl Network {
    /// The network of an address.
    pub(super) fn of(address: IpAddr) -> Self {
        const PREFIX: u128 = u128::MAX << 64;
        Self(match address.to_canonical() {
            IpAddr::V6(six) if !six.is_loopback() => IpAddr::V6(Ipv6Addr::from_bits(six.to_bits() & PREFIX)),
            alone => alone,
        })
    }

    /// Returns true for this machine.
    pub(super) fn is_loopback(self) -> bool {
        self.0.is_loopback()
    }
}

impl std::fmt::Display for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            IpAddr::V6(six) if !six.is_loopback() => write!(f, "{six}/64"),
            alone => write!(f, "{alone}"),
        }
    }
}

/// Reverse proxies that name the client of each request.
#[derive(Debug, Clone, Default)]
pub(super) struct Proxies(Arc<[IpAddr]>);

impl Proxies {
    /// Proxies with these addresses.
    pub(super) fn new(addresses: &[IpAddr]) -> Self {
        Self(addresses.iter().map(IpAddr::to_canonical).collect())
    }

    /// Returns true for this machine and for a proxy, whose connections are those of many clients.
    pub(super) fn serves_many(&self, network: Network) -> bool {
        network.is_loopback() || self.has(network)
    }

    fn has(&self, network: Network) -> bool {
        self.0.iter().any(|address| Network::of(*address) == network)
    }

    /// The client of a request that `peer` sent: the last address in `X-Forwarded-For` that is no proxy. The client
    /// may have invented those before it.
    pub(super) fn client(&self, peer: Network, headers: &HeaderMap) -> Network {
        if !self.has(peer) {
            return peer;
        }
        let lines: Vec<&str> =
            headers.get_all("x-forwarded-for").iter().filter_map(|line| line.to_str().ok()).collect();
        let mut named = lines.iter().rev().flat_map(|line| line.rsplit(','));
        let mut client = peer;
        while self.has(client) {
            match named.next().and_then(|address| address.trim().parse().ok()) {
                Some(address) => client = Network::of(address),
                None => break,
            }
        }
        client
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trusted_proxy_names_the_client_and_no_other_sender_does() {
        let proxies = Proxies::new(&["127.0.0.1".parse().unwrap(), "10.0.0.9".parse().unwrap()]);
        let of = |text: &str| Network::of(text.parse().unwrap());
        for (peer, forwarded, client) in [
            ("127.0.0.1", &["192.0.2.7"][..], "192.0.2.7"),
            ("127.0.0.1", &["6.6.6.6, 192.0.2.7, 10.0.0.9"], "192.0.2.7"),
            ("10.0.0.9", &["6.6.6.6", "2001:db8::7"], "2001:db8::7"),
            ("127.0.0.1", &["nonsense"], "127.0.0.1"),
            ("127.0.0.1", &[], "127.0.0.1"),
            ("192.0.2.8", &["127.0.0.1"], "192.0.2.8"),
        ] {
            let mut headers = HeaderMap::new();
            for line in forwarded {
                headers.append("x-forwarded-for", line.parse().unwrap());
            }
            assert_eq!(proxies.client(of(peer), &headers), of(client), "{peer} {forwarded:?}");
        }
        assert!(proxies.serves_many(of("10.0.0.9")) && proxies.serves_many(of("::1")));
        assert!(!proxies.serves_many(of("10.0.0.8")));
    }

    #[test]
    fn an_address_of_version_4_and_a_network_of_version_6_are_one_client() {
        let of = |text: &str| Network::of(text.parse().unwrap());
        for (one, other) in [
            ("2001:db8::1", "2001:db8::ffff:ffff:ffff:ffff"),
            ("::ffff:10.0.0.1", "10.0.0.1"),
            ("::ffff:127.0.0.1", "127.0.0.1"),
        ] {
            assert_eq!(of(one), of(other), "{one}, {other}");
        }
        for (one, other) in [
            ("2001:db8::1", "2001:db8:0:1::1"),
            ("10.0.0.1", "10.0.0.2"),
            ("::1", "::2"),
            ("::1", "127.0.0.1"),
        ] {
            assert_ne!(of(one), of(other), "{one}, {other}");
        }
        for here in ["127.0.0.1", "127.1.2.3", "::1", "::ffff:127.0.0.1"] {
            assert!(of(here).is_loopback(), "{here}");
        }
        assert!(!of("::2").is_loopback());
        assert_eq!(
            (of("2001:db8::7").to_string(), of("::1").to_string()),
            ("2001:db8::/64".into(), "::1".into())
        );
    }
}
