//! Memory of channels that goes round. The channels of a cycle are about as long as those of the cycle before it; memory
//! that is given back to the system and asked for again costs a fault for each page, and lies in pieces.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most channels that wait to be taken again: about those of one cycle of a six-axis arm, raw and filtered. A channel of a
/// long cycle is most of a megabyte.
const MOST: usize = 64;

/// New memory has room for this part of its length more, one in 64: cycles of a test differ by some rows.
const MARGIN: usize = 64;

/// Channels that were given back, shared by all that work on an export; those of the default are given back to the system.
#[derive(Debug, Clone, Default)]
pub struct Buffers(Option<Arc<Mutex<Vec<Vec<f64>>>>>);

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
            if waiting.len() < MOST && channel.capacity() > 0 {
                waiting.push(channel);
            }
        }
    }

    fn taken(&self, length: usize) -> Vec<f64> {
        let again = self.waiting().and_then(|mut waiting| {
            let place = waiting.iter().rposition(|channel| channel.capacity() >= length)?;
            Some(waiting.swap_remove(place))
        });
        again.unwrap_or_else(|| Vec::with_capacity(length + length / MARGIN))
    }

    fn waiting(&self) -> Option<MutexGuard<'_, Vec<Vec<f64>>>> {
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
        let longer = buffers.channel(2000);
        assert_eq!((longer.len(), longer.as_ptr() == place), (2000, false));
        let shorter = buffers.channel(900);
        assert_eq!((shorter.len(), shorter.as_ptr()), (900, place));
        // of those that are long enough, the one that was given back last
        buffers.clone().give_back([longer, shorter]);
        let again = buffers.room(1010);
        assert_eq!((again.len(), again.as_ptr()), (0, place), "a part more fits");
        assert!(again.capacity() >= 1010);
    }

    #[test]
    fn no_more_wait_than_are_needed() {
        let buffers = Buffers::going_round();
        buffers.give_back((0..2 * MOST).map(|_| vec![0.0]));
        assert_eq!(buffers.waiting().map(|waiting| waiting.len()), Some(MOST));
        let none = Buffers::default();
        none.give_back([vec![1.0; 8]]);
        assert_eq!((none.channel(3), none.room(7)), (vec![0.0; 3], Vec::new()));
    }
}
