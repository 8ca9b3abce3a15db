//! Range of the bytes of an export that a request contains, according to its headers.

use axum::http::header::{CONTENT_LENGTH, CONTENT_RANGE};
use axum::http::{HeaderMap, StatusCode};

use super::answer::Refusal;
use super::receive::too_large;

/// Range of the bytes of an export that a request contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ByteRange {
    /// Position of the first byte.
    pub first: u64,
    /// Bytes of the body, if the client gives them.
    pub length: Option<u64>,
    /// Bytes of the whole export, if the client sends it in parts.
    pub total: Option<u64>,
}

impl ByteRange {
    /// Reads `Content-Range: bytes FIRST-LAST/TOTAL`, or `bytes */TOTAL` if all bytes have arrived and only the end is
    /// missing.
    ///
    /// # Errors
    /// 400 for a header that is not a range, 413 for more than `most` bytes.
    pub fn of(headers: &HeaderMap, most: u64) -> Result<Self, Refusal> {
        let length = headers.get(CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
        let part = match headers.get(CONTENT_RANGE) {
            None => Self { first: 0, length, total: None },
            Some(range) => {
                let wrong = || {
                    Refusal::new(
                        StatusCode::BAD_REQUEST,
                        "write Content-Range as \"bytes FIRST-LAST/TOTAL\", in step with Content-Length",
                    )
                };
                let range = range.to_str().ok().and_then(parse_range).ok_or_else(wrong)?;
                if length.is_some() && range.length.is_some() && length != range.length {
                    return Err(wrong());
                }
                range
            }
        };
        if part.total.or(part.length).is_some_and(|bytes| bytes > most) {
            return Err(too_large(most));
        }
        Ok(part)
    }

    /// Returns true if the bytes that have arrived so far are discarded.
    pub fn is_from_start(self) -> bool {
        self.first == 0 && (self.total.is_none() || self.length != Some(0))
    }

    /// Most bytes of the body.
    pub fn most(self, most: u64) -> u64 {
        if self.total.is_some() { self.length.unwrap_or(0) } else { most }
    }
}

fn parse_range(text: &str) -> Option<ByteRange> {
    let (range, total) = text.trim().strip_prefix("bytes ")?.split_once('/')?;
    let total: u64 = total.parse().ok()?;
    if range == "*" {
        return Some(ByteRange { first: total, length: Some(0), total: Some(total) });
    }
    let (first, last) = range.split_once('-')?;
    let (first, last): (u64, u64) = (first.parse().ok()?, last.parse().ok()?);
    let length = last.checked_sub(first)?.checked_add(1)?;
    (last < total).then_some(ByteRange { first, length: Some(length), total: Some(total) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(range: Option<&str>, length: Option<u64>) -> Result<ByteRange, StatusCode> {
        let mut headers = HeaderMap::new();
        if let Some(range) = range {
            headers.insert(CONTENT_RANGE, range.parse().unwrap());
        }
        if let Some(length) = length {
            headers.insert(CONTENT_LENGTH, length.into());
        }
        ByteRange::of(&headers, 1000).map_err(|refusal| refusal.status)
    }

    #[test]
    fn a_range_says_where_a_part_stands() {
        let of = |first, length, total| Ok(ByteRange { first, length, total });
        assert_eq!(part(None, Some(7)), of(0, Some(7), None));
        assert_eq!(part(Some("bytes 5-9/10"), Some(5)), of(5, Some(5), Some(10)));
        assert_eq!(part(Some("bytes 0-9/10"), None), of(0, Some(10), Some(10)));
        assert_eq!(part(Some("bytes */10"), Some(0)), of(10, Some(0), Some(10)));
        assert!(!part(Some("bytes */0"), None).unwrap().is_from_start());
        let wrong =
            ["bytes 5-10/10", "bytes 9-5/10", "5-9/10", "bytes 0-18446744073709551615/10", "bytes 0-9/*"];
        for range in wrong {
            assert_eq!(part(Some(range), None), Err(StatusCode::BAD_REQUEST), "{range}");
        }
        assert_eq!(part(Some("bytes 5-9/10"), Some(6)), Err(StatusCode::BAD_REQUEST));
        assert_eq!(part(None, Some(1001)), Err(StatusCode::PAYLOAD_TOO_LARGE));
        assert_eq!(part(Some("bytes 0-9/1001"), None), Err(StatusCode::PAYLOAD_TOO_LARGE));
    }
}
