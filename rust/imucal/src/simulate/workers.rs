//! Work shared out to threads.

use std::sync::{Mutex, PoisonError};

/// Does every job once, on up to `threads` threads, in any order: the jobs must not depend on each other.
pub(crate) fn share_out<J: Send>(threads: usize, jobs: Vec<J>, work: impl Fn(J) + Sync) {
    let threads = threads.min(jobs.len());
    if threads <= 1 {
        jobs.into_iter().for_each(work);
        return;
    }
    let queue = Mutex::new(jobs.into_iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let drain = || {
        while let Some(job) = next() {
            work(job);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(drain);
        }
        drain();
    });
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
        }
    }
}
