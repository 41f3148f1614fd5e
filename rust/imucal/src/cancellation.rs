//! Cancellation of long calculations.
//!
//! A calculation that was started by [`Cancellation::run`] ends soon after [`Cancellation::cancel`] is called from any
//! thread, or after the poll function (see [`Cancellation::with_poll`]) has returned true. The loops of this crate
//! check for a cancellation once per iteration. A cancelled calculation unwinds its stack, so functions that return no
//! `Result` can also be cancelled. All threads of the calculation end before [`Cancellation::run`] returns, and no
//! partial result is returned. The program must be built with `panic = "unwind"`, which is the default.
//!
//! ```
//! use imucal::cancellation::Cancellation;
//! use imucal::error::Error;
//! use imucal::simulate::{Program, RandomMoves, Unit, simulate};
//!
//! # fn main() -> Result<(), Error> {
//! let (rate_hz, gravity_mps2, seed) = (100.0, 9.80665, 1);
//! let program = Program::random(&RandomMoves::default(), seed)?;
//! let cancellation = Cancellation::new();
//! cancellation.cancel(); // usually from another thread
//! let run = cancellation.run(|| simulate(&program, &Unit::paper(), rate_hz, gravity_mps2, seed));
//! assert!(matches!(run, Err(Error::Cancelled)));
//! # Ok(())
//! # }
//! ```

use std::any::Any;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::error::Error;

/// Minimum time between two calls of the poll function. A user does not notice a delay of this length. The calls take
/// much less than one percent of the computing time.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(50);

type Poll = dyn Fn() -> bool + Send + Sync;

/// A request to end a calculation. Clones share the request.
#[derive(Clone)]
pub struct Cancellation {
    is_requested: Arc<AtomicBool>,
    poll: Option<Arc<Poll>>,
}

/// Panic payload with which a cancelled calculation unwinds.
struct Cancelled;

/// The cancellation of the calculation that runs on this thread, and the time of the last call of its poll function.
struct Current {
    cancellation: Cancellation,
    last_poll: Instant,
}

thread_local! {
    static CURRENT: RefCell<Option<Current>> = const { RefCell::new(None) };
}

impl Cancellation {
    /// Creates a cancellation on which [`cancel`](Self::cancel) has not been called yet.
    #[must_use]
    pub fn new() -> Self {
        Self { is_requested: Arc::default(), poll: None }
    }

    /// Creates a cancellation that has an additional trigger: a calculation is also cancelled if `poll` returns true.
    /// The calculation calls `poll` about every 50 ms, on the thread that has called [`Cancellation::run`].
    #[must_use]
    pub fn with_poll(poll: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self { is_requested: Arc::default(), poll: Some(Arc::new(poll)) }
    }

    /// Requests the end of all calculations that run with this cancellation or a clone of it.
    pub fn cancel(&self) {
        self.is_requested.store(true, Ordering::Relaxed);
    }

    /// Whether the end of the calculations with this cancellation has been requested.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.is_requested.load(Ordering::Relaxed)
    }

    /// Runs `work` until it returns or is cancelled. If `work` itself calls this function, the inner calculation ends
    /// only if its own cancellation is requested.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the calculation was cancelled before it returned. Otherwise, the error that `work`
    /// returns.
    pub fn run<T>(&self, work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        // A cancelled calculation returns no result, so data in an intermediate state are never used. Therefore,
        // `AssertUnwindSafe` is valid here.
        catch_unwind(AssertUnwindSafe(|| self.enter(work))).unwrap_or_else(|payload| {
            if is_cancellation(&*payload) { Err(Error::Cancelled) } else { resume_unwind(payload) }
        })
    }

    /// Runs `work` with `self` as the cancellation of the present thread.
    pub(crate) fn enter<T>(&self, work: impl FnOnce() -> T) -> T {
        let current = Current { cancellation: self.clone(), last_poll: Instant::now() };
        let _restored = Restored(CURRENT.replace(Some(current)));
        work()
    }

    /// The cancellation for a worker thread of the calculation that runs on this thread; `None` if no calculation runs.
    /// It has no poll function, because only the thread that called [`Cancellation::run`] polls.
    pub(crate) fn for_helper() -> Option<Self> {
        let of_current = |current: &Current| Self { poll: None, ..current.cancellation.clone() };
        CURRENT.with_borrow(|current| current.as_ref().map(of_current))
    }
}

impl Default for Cancellation {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Debug for Cancellation {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Cancellation").field("is_cancelled", &self.is_cancelled()).finish_non_exhaustive()
    }
}

/// Guard that restores the cancellation of the outer calculation when it is dropped, also if the inner calculation
/// unwinds.
struct Restored(Option<Current>);

impl Drop for Restored {
    fn drop(&mut self) {
        CURRENT.set(self.0.take());
    }
}

/// Unwinds the stack of the current calculation if it has been cancelled. Every loop that can take longer than some
/// milliseconds calls this function once per iteration.
pub(crate) fn checkpoint() {
    let (is_cancelled, poll) = CURRENT.with_borrow_mut(|current| {
        let Some(current) = current else { return (false, None) };
        let is_due = current.cancellation.poll.is_some() && current.last_poll.elapsed() >= POLL_INTERVAL;
        if is_due {
            current.last_poll = Instant::now();
        }
        let poll = is_due.then(|| current.cancellation.clone());
        (current.cancellation.is_cancelled(), poll)
    });
    // The poll function may start another calculation, so it is called after the borrow of `CURRENT` has ended.
    let is_polled = poll.is_some_and(|cancellation| {
        let is_requested = cancellation.poll.as_ref().is_some_and(|poll| poll());
        if is_requested {
            cancellation.cancel();
        }
        is_requested
    });
    if is_cancelled || is_polled {
        // Unlike `panic!`, `resume_unwind` prints no message.
        resume_unwind(Box::new(Cancelled));
    }
}

fn is_cancellation(payload: &(dyn Any + Send)) -> bool {
    payload.is::<Cancelled>()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;
    use crate::numerics::workers::{in_order, share_out};

    /// A calculation that ends only if it is cancelled.
    fn endless() -> Result<(), Error> {
        loop {
            checkpoint();
        }
    }

    #[test]
    fn work_without_a_request_returns_its_result() {
        assert_eq!(Cancellation::new().run(|| Ok(7)).unwrap(), 7);
        let error = Cancellation::new().run(|| Err::<(), _>(Error::Fit("f".into()))).unwrap_err();
        assert!(matches!(error, Error::Fit(_)));
        // Outside of `run`, a checkpoint has no effect.
        checkpoint();
    }

    #[test]
    fn another_thread_ends_the_work() {
        let cancellation = Cancellation::new();
        let other = cancellation.clone();
        let found = std::thread::scope(|scope| {
            scope.spawn(move || other.cancel());
            cancellation.run(endless)
        });
        assert!(matches!(found, Err(Error::Cancelled)));
    }

    #[test]
    fn the_poll_function_ends_the_work() {
        let calls = Arc::new(AtomicUsize::new(0));
        let counted = calls.clone();
        let cancellation = Cancellation::with_poll(move || counted.fetch_add(1, Ordering::Relaxed) == 1);
        assert!(matches!(cancellation.run(endless), Err(Error::Cancelled)));
        assert_eq!(calls.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn all_threads_end() {
        for threads in [1, 2, 5] {
            let cancellation = Cancellation::new();
            let begun = AtomicUsize::new(0);
            let found = cancellation.run(|| {
                in_order(threads, 1000, |_| {
                    // Every thread has a job that ends only when the calculation is cancelled.
                    if begun.fetch_add(1, Ordering::Relaxed) + 1 == threads {
                        cancellation.cancel();
                    }
                    if threads > 1 {
                        endless().unwrap_or_default()
                    }
                });
                Ok(())
            });
            assert!(matches!(found, Err(Error::Cancelled)), "{threads} threads");
            assert_eq!(begun.load(Ordering::Relaxed), threads, "{threads} threads");
        }
    }

    #[test]
    fn the_first_thread_polls_while_it_waits_for_the_others() {
        let cancellation = Cancellation::with_poll(|| true);
        let found = cancellation.run(|| {
            // One of the two jobs ends at once.
            share_out(2, vec![false, true], |is_endless| {
                if is_endless {
                    endless().unwrap_or_default()
                }
            });
            Ok(())
        });
        assert!(matches!(found, Err(Error::Cancelled)));
    }

    #[test]
    fn an_inner_calculation_has_its_own_cancellation() {
        let (outer, inner) = (Cancellation::new(), Cancellation::new());
        inner.cancel();
        let found = outer.run(|| {
            assert!(matches!(inner.run(endless), Err(Error::Cancelled)));
            checkpoint();
            outer.cancel();
            endless()
        });
        assert!(matches!(found, Err(Error::Cancelled)));
    }

    #[test]
    fn a_panic_stays_a_panic() {
        let found = catch_unwind(|| Cancellation::new().run(|| -> Result<(), Error> { panic!("a fault") }));
        assert_eq!(found.unwrap_err().downcast_ref::<&str>(), Some(&"a fault"));
    }
}
