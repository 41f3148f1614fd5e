//! Distributes work to threads.

use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{self, Thread};

use crate::cancellation::{Cancellation, POLL_INTERVAL, checkpoint};

/// Minimum number of samples for which several threads are used. With fewer samples, starting the threads would take
/// about as long as the work itself.
const WORTH_THREADS: usize = 500_000;

/// Number of threads for a pass over `samples` samples. It is the number of processors, or one if several threads would
/// not be faster.
pub(crate) fn threads_for(samples: usize) -> usize {
    if samples < WORTH_THREADS { 1 } else { processors() }
}

/// Number of threads that can run in parallel. The system is queried only once, because the query takes as long as a
/// pass over a short recording.
pub(crate) fn processors() -> usize {
    static COUNT: OnceLock<usize> = OnceLock::new();
    *COUNT.get_or_init(|| thread::available_parallelism().map_or(1, NonZeroUsize::get))
}

/// Calls `work` for all indices below `count`, and returns the results in the order of the indices. After a
/// cancellation, no further index is processed.
pub(crate) fn in_order<R: Send>(threads: usize, count: usize, work: impl Fn(usize) -> R + Sync) -> Vec<R> {
    if threads <= 1 {
        let one = |index| {
            checkpoint();
            work(index)
        };
        return (0..count).map(one).collect();
    }
    let mut made: Vec<Option<R>> = (0..count).map(|_| None).collect();
    share_out(threads, made.iter_mut().enumerate().collect(), |(place, made)| *made = Some(work(place)));
    made.into_iter().flatten().collect()
}

/// Processes each job once, on up to `threads` threads and in any order. The jobs must not depend on each other. After
/// a cancellation, no further job is started.
pub(crate) fn share_out<J: Send>(threads: usize, jobs: Vec<J>, work: impl Fn(J) + Sync) {
    let threads = threads.min(jobs.len());
    let queue = Mutex::new(jobs.into_iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let drain = || {
        while let Some(job) = next() {
            checkpoint();
            work(job);
        }
    };
    if threads <= 1 {
        return drain();
    }
    let (cancellation, caller) = (Cancellation::for_helper(), thread::current());
    let working = AtomicUsize::new(threads - 1);
    let help = || {
        let _done = Done { working: &working, caller: &caller };
        match &cancellation {
            Some(cancellation) => cancellation.enter(drain),
            None => drain(),
        }
    };
    thread::scope(|scope| {
        let helpers: Vec<_> = (1..threads).map(|_| scope.spawn(help)).collect();
        drain();
        while working.load(Ordering::Acquire) > 0 {
            thread::park_timeout(POLL_INTERVAL);
            checkpoint();
        }
        for helper in helpers {
            helper.join().unwrap_or_else(|payload| resume_unwind(payload));
        }
    });
}

/// Guard that a worker thread drops when it returns or panics. The guard then decrements `working`, the number of
/// worker threads that still run, and wakes `caller`, the thread that waits for them.
struct Done<'a> {
    working: &'a AtomicUsize,
    caller: &'a Thread,
}

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.working.fetch_sub(1, Ordering::Release);
        self.caller.unpark();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_job_is_done_once() {
        for threads in [0, 1, 2, 3, 100] {
            let mut done = vec![0; 50];
            share_out(threads, done.iter_mut().enumerate().collect(), |(i, place)| *place += i);
            assert!(done.iter().enumerate().all(|(i, place)| *place == i), "{threads} threads");
            assert!(in_order(threads, 50, |i| i * i).into_iter().eq((0..50).map(|i| i * i)), "{threads} threads");
        }
    }
}
