//! Values as bytes of a BLOB; numbers keep every bit.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The bytes of a value.
pub(in crate::robot) fn packed(value: &impl Serialize) -> sqlx::Result<Vec<u8>> {
    postcard::to_stdvec(value).map_err(|error| sqlx::Error::Encode(error.into()))
}

/// The value of bytes from [`packed`]; `None` for others.
pub(in crate::robot) fn unpacked<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).ok()?;
    rest.is_empty().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_to_the_last_bit_and_other_bytes_are_refused() {
        let value = (vec![Some(1.0 / 3.0), None, Some(f64::MIN_POSITIVE)], i64::MIN, "höher".to_owned());
        let bytes = packed(&value).expect("bytes");
        assert_eq!(unpacked(&bytes), Some(value));
        type Value = (Vec<Option<f64>>, i64, String);
        assert_eq!(unpacked::<Value>(&bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked::<Value>(&[&bytes[..], &[0]].concat()), None);
        assert!(unpacked::<f64>(&packed(&f64::NAN).expect("bytes")).is_some_and(f64::is_nan));
    }
}
