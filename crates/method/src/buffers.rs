//! Memory of channels that goes round. The channels of a cycle are about as long as those of the cycle before it; memory
//! that is given back to the system and asked for again costs a fault for each page, and lies in pieces.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Fewest numbers of a channel that is used again. Allocators cache shorter ones, and a short channel must not take the
/// memory of a long one.
const LEAST: usize = 512;

/// Most numbers in all channels that wait together, 192 MiB: those of some cycles of a million rows would be gigabytes.
const MOST_NUMBERS: usize = (192 << 20) / size_of::<f64>();

/// Most channels that wait to be taken again: about those of three cycles of a six-axis arm, raw and filtered. New memory is only
/// asked for while none waits, so that they are no more than were in use at once; a channel of a long cycle is most of a megabyte.
const MOST: usize = 256;

/// New memory has room for this part of its length more, one in 8: cycles of a test differ by some rows, and a cycle that is
/// still being read holds rows of the next one too. So the memory of any channel of a cycle serves any other.
const MARGIN: usize = 8;

/// Channels that were given back, shared by all that work on an export; those of the default are given back to the system.
#[derive(Debug, Clone, Default)]
pub struct Buffers(Option<Arc<Mutex<WaitingChannels>>>);

/// Channels that wait to be taken.
#[derive(Debug, Default)]
struct WaitingChannels {
    channels: Vec<Vec<f64>>,
    /// Numbers that they have room for.
    numbers: usize,
}

/// What they hold means nothing.
impl PartialEq for Buffers {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Buffers {
    /// Buffers that keep what is given back, until the last one who has them drops them.
    #[must_use]
    pub fn going_round() -> Self {
        Self(Some(Arc::default()))
    }

    /// A channel of `length` numbers that mean nothing.
    #[must_use]
    pub fn channel(&self, length: usize) -> Vec<f64> {
        let mut channel = self.taken(length);
        channel.resize(length, 0.0);
        channel
    }

    /// An empty channel with room for `length` numbers.
    #[must_use]
    pub fn room(&self, length: usize) -> Vec<f64> {
        let mut channel = self.taken(length);
        channel.clear();
        channel
    }

    /// Takes channels that are not needed any more.
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
            // all are too short, and new memory takes the place of one of them
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
        // of those that are long enough, the one that was given back last
        buffers.clone().give_back([vec![0.0; 2000], shorter]);
        let again = buffers.room(1100);
        assert_eq!((again.len(), again.as_ptr()), (0, place), "a part more fits");
        assert!(again.capacity() >= 1100);
    }

    /// Channels that wait, and the numbers that they have room for.
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
        // the memory of long channels is bounded, too; it is not touched here
        let buffers = Buffers::going_round();
        buffers.give_back((0..8).map(|_| Vec::with_capacity(MOST_NUMBERS / 4)));
        assert_eq!(waiting(&buffers), (4, MOST_NUMBERS));
        let none = Buffers::default();
        none.give_back([vec![1.0; 8]]);
        assert_eq!((none.channel(3), none.room(7)), (vec![0.0; 3], Vec::new()));
    }
}
