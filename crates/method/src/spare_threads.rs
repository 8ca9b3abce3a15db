//! Spare threads for independent parts of the work. The results do not depend on the thread that computes them. The
//! caller lends the threads; this module starts none.

use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Runs some work here and, at the same time, on the spare threads up to the given number; returns after all have
/// finished.
type RunAtOnce = dyn Fn(usize, &(dyn Fn() + Sync)) + Send + Sync;

/// Access to spare threads; the default has none.
#[derive(Clone, Default)]
pub struct SpareThreads(Option<Arc<RunAtOnce>>);

impl fmt::Debug for SpareThreads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SpareThreads").field(&self.0.is_some()).finish()
    }
}

impl SpareThreads {
    /// Spare threads lent by `run`: it runs the given work here and, at the same time, on the spare threads up to the
    /// given number, and returns after all have finished.
    #[must_use]
    pub fn lent_by(run: impl Fn(usize, &(dyn Fn() + Sync)) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(run)))
    }

    /// Results of `work` for the parts `0..count`, in order. `begin` creates the state that a thread keeps between
    /// parts.
    pub fn each<S, T: Send>(
        &self,
        count: usize,
        begin: impl Fn() -> S + Sync,
        work: impl Fn(&mut S, usize) -> T + Sync,
    ) -> Vec<T> {
        let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(count)));
        let take_parts = || {
            let mut own = None;
            loop {
                let part = next.fetch_add(1, Ordering::Relaxed);
                if part >= count {
                    return;
                }
                let found = work(own.get_or_insert_with(&begin), part);
                done.lock().unwrap_or_else(PoisonError::into_inner).push((part, found));
            }
        };
        if let Some(run) = &self.0 {
            run(count.saturating_sub(1), &take_parts);
        }
        // remaining parts
        take_parts();
        let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
        done.sort_unstable_by_key(|(part, _)| *part);
        done.into_iter().map(|(_, found)| found).collect()
    }

    /// Results of both; without a spare thread `one` runs first.
    pub fn both<A: Send + Default, B: Send + Default>(
        &self,
        one: impl FnOnce() -> A + Send,
        other: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        let (one, other) = (Mutex::new(Some(one)), Mutex::new(Some(other)));
        let found = self.each(
            2,
            || (),
            |(), part| match part {
                0 => (taken(&one).map(|one| one()), None),
                _ => (None, taken(&other).map(|other| other())),
            },
        );
        let (mut of_one, mut of_other) = (None, None);
        for (a, b) in found {
            of_one = of_one.or(a);
            of_other = of_other.or(b);
        }
        // each ran exactly once
        (of_one.unwrap_or_default(), of_other.unwrap_or_default())
    }
}

fn taken<F>(work: &Mutex<Option<F>>) -> Option<F> {
    work.lock().unwrap_or_else(PoisonError::into_inner).take()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_come_in_their_order_however_often_the_work_is_run() {
        for times in [0, 1, 3] {
            let spare = SpareThreads::lent_by(move |_, work| (0..times).for_each(|_| work()));
            for count in [0, 1, 2, 50] {
                let found = spare.each(
                    count,
                    || 0,
                    |done, part| {
                        *done += 1;
                        (part * part, *done)
                    },
                );
                let expected: Vec<(usize, usize)> = (0..count).map(|part| (part * part, part + 1)).collect();
                assert_eq!(found, expected);
            }
            assert_eq!(spare.both(|| 1, || "two"), (1, "two"));
        }
        assert_eq!(SpareThreads::default().both(|| 'a', || 'b'), ('a', 'b'));
    }
}
