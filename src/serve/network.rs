//! The client behind an address, for limits that hold per client.

use std::net::{IpAddr, Ipv6Addr};

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

#[cfg(test)]
mod tests {
    use super::*;

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
