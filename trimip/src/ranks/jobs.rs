//! Jobs that any rank can do by itself: views to render or to measure, runs to train. Free ranks get the next jobs, and results are
//! delivered in the order of the jobs.

use super::orders::Order;
use crate::machine;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use trimip_core::{
    Error, Result,
    engine::exchange::{Ranks, fault},
    scene::fingerprint,
};

/// Answer of a rank that has the same jobs as rank 0.
const READY: &[u8] = b"ready";

/// Job number that ends the work of a rank.
const NO_MORE: u64 = u64::MAX;

/// Number of jobs that a rank has at a time, so that it begins the next one without waiting.
const AHEAD: usize = 2;

/// Time between two checks of rank 0 for results.
const NAP: Duration = Duration::from_millis(1);

/// Returns a hash of `parts`, as the description of jobs for [`scatter_jobs`] and [`work_on_jobs`].
pub fn digest(parts: impl IntoIterator<Item = String>) -> String {
    format!("{:016x}", fingerprint::hash_of(parts))
}

/// The result of a job as a rank sends it.
#[derive(Serialize, Deserialize)]
struct Done<T> {
    job: u64,
    result: Result<T>,
}

/// The jobs and their results, on rank 0.
struct JobQueue<'a, T> {
    jobs: &'a [usize],
    /// Returns false when the jobs are to stop.
    going: &'a (dyn Fn() -> bool + Sync),
    state: Mutex<State<T>>,
    changed: Condvar,
}

struct State<T> {
    /// Index of the next job to hand out.
    next: usize,
    /// True when no more jobs are handed out.
    closed: bool,
    /// True after a panic on rank 0, which then waits for no results.
    abandoned: bool,
    /// Results by the index of their job.
    done: BTreeMap<usize, Result<T>>,
    /// Error after which no results of other ranks can arrive.
    broken: Option<Error>,
}

/// Does `jobs` on all ranks: rank 0 calls this function, while the others [`follow`](super::follow). `what` describes the jobs and has to
/// be the same on every rank. `own` does a job on this rank, while another thread hands out jobs to the others. `take` receives the results
/// in the order of the jobs and returns false to stop. No job is handed out once `going` returns false.
///
/// # Errors
/// The first error of a job or of `take`, or when another rank is gone.
pub fn scatter_jobs<T: DeserializeOwned + Serialize + Send>(
    ranks: &dyn Ranks,
    what: &str,
    jobs: &[usize],
    going: &(dyn Fn() -> bool + Sync),
    own: impl FnMut(usize) -> Result<T>,
    take: impl FnMut(usize, T) -> Result<bool>,
) -> Result<()> {
    Order::Jobs { version: machine::version() }.give(ranks)?;
    // Rank 0 does the first job itself, so that an error common to all jobs shows there first.
    let state = State { next: 1, closed: false, abandoned: false, done: BTreeMap::new(), broken: None };
    let queue = JobQueue { jobs, going, state: Mutex::new(state), changed: Condvar::new() };
    std::thread::scope(|scope| {
        let served = scope.spawn(|| queue.serve(ranks, what).inspect_err(|error| queue.fail(error.clone())));
        let closing = Closing(&queue);
        let outcome = queue.work(own, take);
        drop(closing);
        let served = served.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        outcome.and(served)
    })
}

/// Closes a queue when dropped, also during a panic: the thread that serves other ranks ends only once the queue is closed.
struct Closing<'a, 'b, T>(&'a JobQueue<'b, T>);

impl<T> Drop for Closing<'_, '_, T> {
    fn drop(&mut self) {
        let state = &mut *self.0.state();
        (state.closed, state.abandoned) = (true, std::thread::panicking());
    }
}

impl<T: DeserializeOwned + Send> JobQueue<'_, T> {
    /// Hands out jobs and receives results until there are no more.
    fn serve(&self, ranks: &dyn Ranks, what: &str) -> Result<()> {
        let others = 1..ranks.rank().size;
        // Every rank first answers whether its jobs are the same as these, and then sends the result of each job that it gets.
        let (mut waiting, mut unready) = (others.len(), others.len());
        let hand_out = |rank, waiting: &mut usize| -> Result<()> {
            if let Some(place) = self.next() {
                ranks.send(rank, &(self.jobs[place] as u64).to_le_bytes())?;
                *waiting += 1;
            }
            Ok(())
        };
        for rank in others.clone() {
            ranks.send(rank, what.as_bytes())?;
        }
        // Waits for the results of all handed-out jobs before it ends the work of the ranks.
        while waiting > 0 && !self.state().abandoned {
            let Some((rank, bytes)) = ranks.try_receive()? else {
                std::thread::sleep(NAP);
                continue;
            };
            waiting -= 1;
            if bytes == READY {
                unready -= 1;
            } else {
                self.receive(rank, &bytes);
            }
            hand_out(rank, &mut waiting)?;
            if bytes == READY && unready == 0 {
                // Every rank gets its first job before any rank gets one in advance.
                for rank in others.clone().cycle().take((AHEAD - 1) * others.len()) {
                    hand_out(rank, &mut waiting)?;
                }
            }
        }
        for rank in others {
            ranks.send(rank, &NO_MORE.to_le_bytes())?;
        }
        self.state().broken.clone().map_or(Ok(()), Err)
    }

    fn receive(&self, rank: usize, bytes: &[u8]) {
        match read(rank, bytes) {
            Ok((job, result)) => match (self.jobs.iter().position(|own| *own == job), result) {
                (Some(place), result) => {
                    self.state().done.insert(place, result);
                    self.changed.notify_all();
                }
                (None, Err(error)) => self.fail(error),
                (None, Ok(_)) => self.fail(Error::run(format!(
                    "rank {rank} returned the result of a job that does not exist"
                ))),
            },
            Err(error) => self.fail(error),
        }
    }

    /// Does this rank's jobs, and passes the results of all jobs to `take`.
    fn work(
        &self,
        mut own: impl FnMut(usize) -> Result<T>,
        mut take: impl FnMut(usize, T) -> Result<bool>,
    ) -> Result<()> {
        let mut taken = 0;
        let mut mine = (!self.jobs.is_empty()).then_some(0);
        while taken < self.jobs.len() && (self.going)() {
            if let Some(place) = mine.take() {
                let result = own(self.jobs[place]);
                self.state().done.insert(place, result);
            }
            while let Some(result) = self.result(taken)? {
                if !take(self.jobs[taken], result?)? {
                    return Ok(());
                }
                taken += 1;
            }
            mine = self.next();
            if mine.is_none() && taken < self.jobs.len() {
                let waits = |state: &mut State<T>| state.broken.is_none() && !state.done.contains_key(&taken);
                // The wait is limited, so that the loop checks `going` now and then.
                let waited = self.changed.wait_timeout_while(self.state(), 100 * NAP, waits);
                drop(waited.unwrap_or_else(PoisonError::into_inner));
            }
        }
        Ok(())
    }

    /// Removes and returns the result of the job at an index, if it has arrived.
    fn result(&self, place: usize) -> Result<Option<Result<T>>> {
        let state = &mut *self.state();
        state.broken.clone().map_or(Ok(()), Err)?;
        Ok(state.done.remove(&place))
    }

    /// Takes the next job from the queue and returns its index.
    fn next(&self) -> Option<usize> {
        if !(self.going)() {
            return None;
        }
        let state = &mut *self.state();
        let next = (!state.closed && state.next < self.jobs.len()).then_some(state.next)?;
        state.next += 1;
        Some(next)
    }
}

impl<T> JobQueue<'_, T> {
    fn fail(&self, error: Error) {
        let state = &mut *self.state();
        state.closed = true;
        state.broken.get_or_insert(error);
        self.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn read<T: DeserializeOwned>(rank: usize, bytes: &[u8]) -> Result<(usize, Result<T>)> {
    let Done { job, result } = serde_json::from_slice(bytes)
        .map_err(|error| Error::run(format!("cannot read a result of rank {rank}: {error}")))?;
    Ok((job as usize, result.map_err(|error| error.of_rank(rank))))
}

/// Does the jobs that rank 0 hands to this rank, until there are no more.
///
/// # Errors
/// When rank 0 is gone. Errors of jobs are sent to rank 0, and also an error if the jobs of rank 0 are not those that `what` describes.
pub fn work_on_jobs<T: Serialize>(
    ranks: &dyn Ranks,
    what: &str,
    mut own: impl FnMut(usize) -> Result<T>,
) -> Result<()> {
    let (_, theirs) = ranks.receive()?;
    let done = |job, result: Result<T>| serde_json::to_vec(&Done { job, result }).map_err(Error::run);
    let answer = match theirs == what.as_bytes() {
        true => READY.to_vec(),
        false => done(
            NO_MORE,
            Err(Error::input(
                "the jobs of this rank",
                "are not those of rank 0",
                "give every machine the same files under the same paths, and the same number of threads (threads = N)",
            )),
        )?,
    };
    ranks.send(0, &answer)?;
    loop {
        let (_, bytes) = ranks.receive()?;
        let job = <[u8; 8]>::try_from(&bytes[..])
            .map(u64::from_le_bytes)
            .map_err(|_| fault(format_args!("expected a job of 8 bytes, found {} bytes", bytes.len())))?;
        if job == NO_MORE {
            return Ok(());
        }
        ranks.send(0, &done(job, own(job as usize))?)?;
    }
}
