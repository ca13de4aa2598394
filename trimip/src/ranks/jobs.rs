//! Jobs that any rank can do by itself: views to render or to measure, runs to train. They are handed out as ranks come free,
//! and their results come in order.

use super::Order;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use trimip_core::{Error, ErrorKind, Result, exchange::Ranks};

/// The job that means: no more.
const NO_MORE: u64 = u64::MAX;

/// Jobs that a rank has at a time: it begins the next one while rank 0 is busy.
const AHEAD: usize = 2;

/// What a rank sends of a job.
#[derive(Serialize, Deserialize)]
struct Done<T> {
    job: u64,
    result: std::result::Result<T, (u8, String)>,
}

/// Does `jobs` on all ranks, of which this is rank 0; the others are in [`follow`](super::follow). `own` does a job on this
/// rank. `take` gets the results in the order of the jobs, and returns false to stop.
///
/// # Errors
/// The first error of a job or of `take`, or when another rank is gone.
pub fn farm<T: DeserializeOwned + Serialize>(
    ranks: &dyn Ranks,
    jobs: &[usize],
    mut own: impl FnMut(usize) -> Result<T>,
    mut take: impl FnMut(usize, T) -> Result<bool>,
) -> Result<()> {
    Order::Jobs.give(ranks)?;
    let count = jobs.len();
    let hand_out = |rank, place: usize| ranks.send(rank, &(jobs[place] as u64).to_le_bytes());
    let place_of = |job: usize| jobs.iter().position(|own| *own == job).unwrap_or(0);
    let others = 1..ranks.share().of;
    let (mut next, mut waiting, mut taken) = (0, 0, 0);
    let mut done: BTreeMap<usize, Result<T>> = BTreeMap::new();
    let mut outcome = Ok(true);
    // Deal in turn, so that every rank has its first job before any has its second.
    for rank in others.clone().cycle().take(AHEAD * others.len()).take_while(|_| count > 0) {
        if next + 1 < count {
            hand_out(rank, next + 1)?;
            (next, waiting) = (next + 1, waiting + 1);
        }
    }
    // Job 0 is this rank's own: what stops all jobs is seen here first.
    let mut mine = (count > 0).then_some(0);
    if count > 0 {
        next += 1;
    }
    while matches!(outcome, Ok(true)) && taken < count {
        if let Some(job) = mine.take() {
            done.insert(job, own(jobs[job]));
        }
        while let Some((rank, bytes)) = ranks.try_receive()? {
            waiting -= 1;
            let (job, result) = read(rank, &bytes)?;
            done.insert(place_of(job), result);
            if next < count {
                hand_out(rank, next)?;
                (next, waiting) = (next + 1, waiting + 1);
            }
        }
        while let Some(result) = done.remove(&taken) {
            outcome = result.and_then(|result| take(jobs[taken], result));
            taken += 1;
            if !matches!(outcome, Ok(true)) {
                break;
            }
        }
        if next < count {
            mine = Some(next);
            next += 1;
        } else if taken < count && !done.contains_key(&taken) && matches!(outcome, Ok(true)) {
            let (rank, bytes) = ranks.receive()?;
            waiting -= 1;
            let (job, result) = read(rank, &bytes)?;
            done.insert(place_of(job), result);
        }
    }
    // The jobs that were handed out end before the ranks hear that there are no more.
    for _ in 0..waiting {
        ranks.receive()?;
    }
    for rank in others {
        ranks.send(rank, &NO_MORE.to_le_bytes())?;
    }
    outcome.map(drop)
}

fn read<T: DeserializeOwned>(rank: usize, bytes: &[u8]) -> Result<(usize, Result<T>)> {
    let Done { job, result } = serde_json::from_slice(bytes)
        .map_err(|error| Error::run(format!("a result of rank {rank} is not understood: {error}")))?;
    let told = |(code, message): (u8, String)| {
        let kind = [ErrorKind::Run, ErrorKind::Input, ErrorKind::Device]
            .into_iter()
            .find(|kind| kind.exit_code() == code)
            .unwrap_or(ErrorKind::Run);
        Error { kind, message: format!("rank {rank}: {message}") }
    };
    Ok((job as usize, result.map_err(told)))
}

/// Does the jobs that rank 0 hands to this rank, until there are no more.
///
/// # Errors
/// When rank 0 is gone. A job that fails is told to rank 0.
pub fn labour<T: Serialize>(ranks: &dyn Ranks, mut own: impl FnMut(usize) -> Result<T>) -> Result<()> {
    loop {
        let (_, bytes) = ranks.receive()?;
        let job = <[u8; 8]>::try_from(&bytes[..]).map_or(NO_MORE, u64::from_le_bytes);
        if job == NO_MORE {
            return Ok(());
        }
        let result = own(job as usize).map_err(|error| (error.exit_code(), error.message));
        ranks.send(0, &serde_json::to_vec(&Done { job, result }).map_err(Error::run)?)?;
    }
}
