//! Limit of the requests per network: a bucket of tokens that fills at a steady rate.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::network::Network;

/// Requests that may arrive at once, as seconds of the rate. A page sends many when it opens.
const BURST_S: f64 = 4.0;

/// Least number of requests that may arrive at once, even at a low rate.
const LEAST_BURST: f64 = 20.0;

/// Number of remembered networks. Above it, silent ones are forgotten.
const REMEMBERED: usize = 4096;

/// Requests by network.
#[derive(Debug)]
pub(super) struct RequestRates {
    per_second: f64,
    buckets: Mutex<HashMap<Network, Bucket>>,
}

#[derive(Debug, Clone, Copy)]
struct Bucket {
    left: f64,
    at: Instant,
}

impl RequestRates {
    /// Allows `per_second` requests per second and network; 0 is no limit.
    pub(super) fn new(per_second: f64) -> Self {
        Self { per_second, buckets: Mutex::default() }
    }

    /// Counts a request.
    ///
    /// # Errors
    /// The time after which the network may send another one.
    pub(super) fn count(&self, network: Network, now: Instant) -> Result<(), Duration> {
        if self.per_second <= 0.0 {
            return Ok(());
        }
        let most = (BURST_S * self.per_second).max(LEAST_BURST);
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        if buckets.len() >= REMEMBERED {
            let full = Duration::from_secs_f64(most / self.per_second);
            buckets.retain(|_, bucket| now.saturating_duration_since(bucket.at) < full);
        }
        let bucket = buckets.entry(network).or_insert(Bucket { left: most, at: now });
        let filled = now.saturating_duration_since(bucket.at).as_secs_f64() * self.per_second;
        *bucket = Bucket { left: (bucket.left + filled).min(most), at: now };
        if bucket.left < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - bucket.left) / self.per_second));
        }
        bucket.left -= 1.0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(text: &str) -> Network {
        Network::of(text.parse().unwrap())
    }

    #[test]
    fn a_network_has_its_rate_and_takes_none_of_the_others() {
        let (rates, begun) = (RequestRates::new(10.0), Instant::now());
        let one = network("10.0.0.1");
        for _ in 0..40 {
            assert_eq!(rates.count(one, begun), Ok(()));
        }
        let wait = rates.count(one, begun).unwrap_err();
        assert!((wait.as_secs_f64() - 0.1).abs() < 1e-9, "{wait:?}");
        assert_eq!(rates.count(network("::ffff:10.0.0.2"), begun), Ok(()));
        assert_eq!(rates.count(one, begun + wait), Ok(()));
        assert!(rates.count(one, begun + wait).is_err());
        assert!((0..1000).all(|_| RequestRates::new(0.0).count(one, begun).is_ok()));
    }

    #[test]
    fn a_network_is_one_client_and_silent_ones_are_forgotten() {
        let (rates, begun) = (RequestRates::new(0.25), Instant::now());
        assert!((0..20).all(|_| rates.count(network("2001:db8::1"), begun).is_ok()));
        assert!(rates.count(network("2001:db8::2"), begun).is_err());
        assert_eq!(rates.count(network("2001:db8:0:1::1"), begun), Ok(()));
        for number in 0..u32::try_from(REMEMBERED).unwrap() {
            assert!(rates.count(Network::of(number.to_be_bytes().into()), begun).is_ok());
        }
        assert!(rates.count(network("10.9.9.9"), begun + Duration::from_secs(100)).is_ok());
        assert_eq!(rates.buckets.lock().unwrap().len(), 1);
    }
}
