//! Threads that nobody else needs at the moment, for work of independent parts. What parts come to does not depend on which
//! thread does them.

use std::any::Any;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::{fmt, thread};

/// What is held while a thread is lent.
type Loan = Box<dyn Any + Send>;

/// Lends threads beside the one that works; the default lends none.
#[derive(Clone, Default)]
pub struct SpareThreads(Option<Arc<dyn Fn() -> Option<Loan> + Send + Sync>>);

impl fmt::Debug for SpareThreads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SpareThreads").field(&self.0.is_some()).finish()
    }
}

impl SpareThreads {
    /// Threads that `lend` lends: as long as what it gives is not dropped, one more may work.
    #[must_use]
    pub fn lent_by<L: Send + 'static>(lend: impl Fn() -> Option<L> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(move || lend().map(|loan| Box::new(loan) as Loan))))
    }

    /// What `work` gives of each of the parts `0..count`, in their order. `begin` makes what a thread keeps from one part to
    /// the next.
    pub fn each<S, T: Send>(
        &self,
        count: usize,
        begin: impl Fn() -> S + Sync,
        work: impl Fn(&mut S, usize) -> T + Sync,
    ) -> Vec<T> {
        let loans: Vec<Loan> = (1..count).map_while(|_| self.loan()).collect();
        if loans.is_empty() {
            let mut own = begin();
            return (0..count).map(|part| work(&mut own, part)).collect();
        }
        let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(count)));
        let take_parts = &|| {
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
        thread::scope(|scope| {
            for loan in loans {
                let lent = move || {
                    take_parts();
                    drop(loan);
                };
                // without a thread more, this one does all parts
                let _ = thread::Builder::new().name("analysis".into()).spawn_scoped(scope, lent);
            }
            take_parts();
        });
        let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
        done.sort_unstable_by_key(|(part, _)| *part);
        done.into_iter().map(|(_, found)| found).collect()
    }

    /// What both come to; without a spare thread `one` is done first.
    pub fn both<A: Send, B>(&self, one: impl FnOnce() -> A + Send, other: impl FnOnce() -> B) -> (A, B) {
        let Some(loan) = self.loan() else { return (one(), other()) };
        thread::scope(|scope| {
            let lent = scope.spawn(move || {
                let found = one();
                drop(loan);
                found
            });
            let of_other = other();
            match lent.join() {
                Ok(of_one) => (of_one, of_other),
                Err(panic) => resume_unwind(panic),
            }
        })
    }

    fn loan(&self) -> Option<Loan> {
        self.0.as_ref()?()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Barrier;

    use super::*;

    /// Lends `most` threads at once.
    fn lending(most: usize) -> (SpareThreads, Arc<AtomicUsize>) {
        let lent = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&lent);
        let lend = move || {
            let place =
                count.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| (n < most).then_some(n + 1));
            place.ok().map(|_| GiveBack(Arc::clone(&count)))
        };
        (SpareThreads::lent_by(lend), lent)
    }

    struct GiveBack(Arc<AtomicUsize>);

    impl Drop for GiveBack {
        fn drop(&mut self) {
            self.0.fetch_sub(1, Ordering::SeqCst);
        }
    }

    #[test]
    fn parts_come_in_their_order_whoever_does_them() {
        for most in [0, 1, 3, 20] {
            let (spare, lent) = lending(most);
            for count in [0, 1, 2, 7, 50] {
                let found = spare.each(
                    count,
                    || 0,
                    |done, part| {
                        *done += 1;
                        (part * part, *done > 0)
                    },
                );
                let expected: Vec<(usize, bool)> = (0..count).map(|part| (part * part, true)).collect();
                assert_eq!(found, expected);
            }
            assert_eq!(spare.both(|| 1, || "two"), (1, "two"));
            assert_eq!(lent.load(Ordering::SeqCst), 0, "all are given back");
        }
        assert_eq!(SpareThreads::default().both(|| 'a', || 'b'), ('a', 'b'));
    }

    #[test]
    fn lent_threads_work_at_once() {
        let (spare, _) = lending(2);
        let all_there = Barrier::new(3);
        let threads = spare.each(
            3,
            || (),
            |(), _| {
                all_there.wait();
                thread::current().id()
            },
        );
        assert_eq!(threads.into_iter().collect::<HashSet<_>>().len(), 3);
    }

    #[test]
    fn a_panic_of_a_part_is_one_of_all() {
        let (spare, lent) = lending(1);
        let work = || spare.each(4, || (), |(), part| assert!(part != 2, "no part two"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err());
        assert_eq!(lent.load(Ordering::SeqCst), 0);
    }
}
