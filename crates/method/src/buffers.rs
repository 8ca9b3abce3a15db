//! Reuse of memory for channels. The channels of consecutive cycles have similar lengths. Memory that is returned to
//! the system and requested again costs a fault per page, and becomes fragmented.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Shortest channel, in numbers, that is reused. Allocators cache shorter ones, and a short channel must not take the
/// memory of a long one.
const LEAST: usize = 512;

/// Largest total of numbers in all waiting channels, 192 MiB: those of some cycles of a million rows would be
/// gigabytes.
const MOST_NUMBERS: usize = (192 << 20) / size_of::<f64>();

/// Largest number of waiting channels: about those of three cycles of a six-axis arm, raw and filtered. New memory is
/// requested only if none waits, so there are no more of them than were in use at once. A channel of a long cycle takes
/// most of a megabyte.
const MOST: usize = 256;

/// Inverse of the spare room in new memory: one part in 8 of its length. Cycles of a test differ by some rows, and a
/// cycle that is still being read also holds rows of the next one. So the memory of any channel of a cycle fits any
/// other.
const MARGIN: usize = 8;

/// Returned channels, shared by all work on an export. The default releases them to the system.
#[derive(Debug, Clone, Default)]
pub struct Buffers(Option<Arc<Mutex<WaitingChannels>>>);

/// Channels that wait for reuse.
#[derive(Debug, Default)]
struct WaitingChannels {
    channels: Vec<Vec<f64>>,
    /// Total capacity of the channels, in numbers.
    numbers: usize,
}

/// All buffers are equal: their contents are meaningless.
impl PartialEq for Buffers {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Buffers {
    /// Creates buffers that keep returned channels until the last owner is dropped.
    #[must_use]
    pub fn going_round() -> Self {
        Self(Some(Arc::default()))
    }

    /// Channel of `length` arbitrary numbers.
    #[must_use]
    pub fn channel(&self, length: usize) -> Vec<f64> {
        let mut channel = self.taken(length);
        channel.resize(length, 0.0);
        channel
    }

    /// Empty channel with room for `length` numbers.
    #[must_use]
    pub fn room(&self, length: usize) -> Vec<f64> {
        let mut channel = self.taken(length);
        channel.clear();
        channel
    }

    /// Returns channels that are no longer needed.
    pub fn give_back(&self, channels: impl IntoIterator<Item = Vec<f64>>) {
        let Some(mut waiting) = self.waiting() else { return };
        for channel in channels {
            let numbers = waiting.numbers + channel.capacity();
            if channel.capacity() >= LEAST && waiting.channels.len() < MOST && numbers <= MOST_NUMBERS {
                waiting.numbers = numbers;
                waiting.channels.push(channel);
            }
        }
    }

    fn taken(&self, length: usize) -> Vec<f64> {
        if length < LEAST {
            return Vec::with_capacity(length);
        }
        if let Some(mut waiting) = self.waiting() {
            let place = waiting.channels.iter().rposition(|channel| channel.capacity() >= length);
            // if all are too short, new memory replaces one of them
            let taken = match place {
                Some(place) => Some(waiting.channels.swap_remove(place)),
                None => waiting.channels.pop(),
            };
            waiting.numbers -= taken.as_ref().map_or(0, Vec::capacity);
            if let (Some(_), Some(taken)) = (place, taken) {
                return taken;
            }
        }
        Vec::with_capacity(length + length / MARGIN)
    }

    fn waiting(&self) -> Option<MutexGuard<'_, WaitingChannels>> {
        Some(self.0.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_that_was_given_back_is_taken_again_if_it_is_long_enough() {
        let buffers = Buffers::going_round();
        let long = buffers.channel(1000);
        let place = long.as_ptr();
        buffers.give_back([long, Vec::new()]);
        let shorter = buffers.channel(900);
        assert_eq!((shorter.len(), shorter.as_ptr()), (900, place));
        // among those that are long enough, the one that was returned last
        buffers.clone().give_back([vec![0.0; 2000], shorter]);
        let again = buffers.room(1100);
        assert_eq!((again.len(), again.as_ptr()), (0, place), "a part more fits");
        assert!(again.capacity() >= 1100);
    }

    /// Number of waiting channels, and their total capacity.
    fn waiting(buffers: &Buffers) -> (usize, usize) {
        buffers.waiting().map_or((0, 0), |waiting| (waiting.channels.len(), waiting.numbers))
    }

    #[test]
    fn a_long_channel_is_not_taken_for_a_short_one() {
        let buffers = Buffers::going_round();
        buffers.give_back([vec![0.0; 100_000], vec![0.0; LEAST - 1]]);
        assert!(buffers.room(1).capacity() < LEAST);
        assert_eq!(waiting(&buffers), (1, 100_000));
        assert_eq!(buffers.room(LEAST).capacity(), 100_000);
        assert_eq!(waiting(&buffers), (0, 0));
    }

    #[test]
    fn what_is_too_short_does_not_wait_beside_new_memory() {
        let buffers = Buffers::going_round();
        buffers.give_back([vec![0.0; 1000], vec![0.0; 1000]]);
        assert_eq!(buffers.channel(2000).len(), 2000);
        assert_eq!(waiting(&buffers), (1, 1000));
    }

    #[test]
    fn no_more_wait_than_are_needed() {
        let buffers = Buffers::going_round();
        buffers.give_back((0..2 * MOST).map(|_| vec![0.0; LEAST]));
        assert_eq!(waiting(&buffers), (MOST, MOST * LEAST));
        // the memory of long channels is bounded too; this test does not touch it
        let buffers = Buffers::going_round();
        buffers.give_back((0..8).map(|_| Vec::with_capacity(MOST_NUMBERS / 4)));
        assert_eq!(waiting(&buffers), (4, MOST_NUMBERS));
        let none = Buffers::default();
        none.give_back([vec![1.0; 8]]);
        assert_eq!((none.channel(3), none.room(7)), (vec![0.0; 3], Vec::new()));
    }
}
