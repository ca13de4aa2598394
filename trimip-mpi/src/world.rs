//! The processes of an MPI program.

use mpi::environment::Universe;
use mpi::point_to_point::MatchedReceiveVec;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Source};
use mpi::{Rank as MpiRank, Tag, Threading, request};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use trimip_core::engine::exchange::{Rank, Ranks};
use trimip_core::{Error, Result};

/// Tags of messages.
const ALL_TO_ALL: Tag = 1;
const ORDER: Tag = 2;
const MESSAGE: Tag = 3;

/// Maximum number of bytes of a message: MPI counts in i32.
const MOST: usize = 1 << 30;

/// Time for which a rank that waits for a broadcast polls without a pause. Afterwards it sleeps [`NAP`] between polls, so that
/// other threads can use its core.
const EAGER: Duration = Duration::from_millis(5);
const NAP: Duration = Duration::from_micros(200);

/// Traffic of a rank in calls of `all_to_all`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Traffic {
    /// Number of steps.
    pub steps: u64,
    /// Bytes sent to other ranks.
    pub bytes: u64,
    /// Bytes of the touched parts of the gradients, summed over all steps.
    pub touched: u64,
    /// Seconds spent in calls of `all_to_all` after the first, including waits for slower ranks.
    pub trading: f64,
    /// Seconds from the end of the first `all_to_all` to the end of the last.
    pub seconds: f64,
}

/// All processes that were launched together.
#[derive(Default)]
pub struct World {
    /// This rank among all ranks, and among the ranks on its machine; set by [`World::start`].
    ranks: OnceLock<[Rank; 2]>,
    traffic: Mutex<(Traffic, Option<Instant>)>,
    /// Held during every call of MPI, so that only one thread calls MPI at a time.
    calls: Mutex<()>,
    /// MPI's environment, held from [`World::start`] to [`World::end`].
    universe: Mutex<Option<Universe>>,
}

impl World {
    /// Initialises MPI.
    ///
    /// # Errors
    /// When MPI is already initialised, when the MPI library lets only the first thread call it, or when its number of
    /// ranks is not the number of launched processes.
    pub fn start(&self) -> Result<()> {
        let (universe, threading) = mpi::initialize_with_threading(Threading::Serialized)
            .ok_or_else(|| Error::device("MPI has been started before"))?;
        if threading < Threading::Serialized {
            return Err(Error::device(
                "this MPI library lets only the first thread of a program call it; use one with MPI_THREAD_SERIALIZED",
            ));
        }
        let world = universe.world();
        let launched = crate::launched().size;
        if world.size() as usize != launched {
            return Err(Error::input(
                format!("{launched} processes"),
                format!(
                    "the MPI library of this program reports {}: the launcher belongs to another MPI library",
                    world.size()
                ),
                "build the program with the mpicc that belongs to the launcher",
            ));
        }
        let near = world.split_shared(world.rank());
        let this_rank = |id: MpiRank, size: MpiRank| Rank { id: id as usize, size: size as usize };
        self.ranks
            .get_or_init(|| [this_rank(world.rank(), world.size()), this_rank(near.rank(), near.size())]);
        *lock(&self.universe) = Some(universe);
        Ok(())
    }

    /// Returns the traffic of this rank.
    pub fn traffic(&self) -> Traffic {
        lock(&self.traffic).0
    }

    /// Finalises MPI, which waits until every rank does so.
    pub fn end(&self) {
        let _calls = lock(&self.calls);
        drop(lock(&self.universe).take());
    }

    /// Ends all ranks immediately with this exit code.
    pub fn abort(&self, code: u8) -> ! {
        SimpleCommunicator::world().abort(code.into())
    }

    fn ranks(&self) -> [Rank; 2] {
        self.ranks.get().copied().unwrap_or([Rank::ONLY; 2])
    }
}

/// Locks a mutex. Poisoning is ignored, because a thread that panics ends the program.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Converts a rank to MPI's type.
fn number(rank: usize) -> MpiRank {
    rank as MpiRank
}

impl Ranks for World {
    fn rank(&self) -> Rank {
        self.ranks()[0]
    }

    fn on_machine(&self) -> Rank {
        self.ranks()[1]
    }

    fn all_to_all(&self, out: &[&[u8]], into: &mut [Vec<u8>]) -> Result<()> {
        let started = Instant::now();
        let _calls = lock(&self.calls);
        let world = SimpleCommunicator::world();
        let lengths: Vec<u64> = out.iter().map(|bytes| bytes.len() as u64).collect();
        let mut coming = vec![0_u64; self.rank().size];
        world.all_to_all_into(&lengths[..], &mut coming[..]);
        let mut sent = 0;
        request::scope(|scope| {
            let mut requests = Vec::new();
            let own = self.rank().id;
            for (from, bytes) in into.iter_mut().enumerate().filter(|(from, _)| *from != own) {
                bytes.resize(coming[from] as usize, 0);
                for part in bytes.chunks_mut(MOST) {
                    let process = world.process_at_rank(number(from));
                    requests.push(process.immediate_receive_into_with_tag(scope, part, ALL_TO_ALL));
                }
            }
            let mut sends = Vec::new();
            for (to, bytes) in out.iter().enumerate().filter(|(to, _)| *to != own) {
                sent += bytes.len() as u64;
                for part in bytes.chunks(MOST) {
                    let process = world.process_at_rank(number(to));
                    sends.push(process.immediate_send_with_tag(scope, part, ALL_TO_ALL));
                }
            }
            requests.into_iter().chain(sends).for_each(|request| {
                request.wait();
            });
        });
        let (traffic, since) = &mut *lock(&self.traffic);
        traffic.bytes += sent;
        match since {
            Some(since) => {
                traffic.trading += started.elapsed().as_secs_f64();
                traffic.seconds = since.elapsed().as_secs_f64();
            }
            // The first call is not timed, because in it a rank waits for other ranks that still read their data.
            None => *since = Some(Instant::now()),
        }
        Ok(())
    }

    fn broadcast(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let world = SimpleCommunicator::world();
        if self.rank().id == 0 {
            let _calls = lock(&self.calls);
            for to in 1..self.rank().size {
                let process = world.process_at_rank(number(to));
                process.send_with_tag(&[bytes.len() as u64][..], ORDER);
                bytes.chunks(MOST).for_each(|part| process.send_with_tag(part, ORDER));
            }
            return Ok(());
        }
        let started = Instant::now();
        let leader = world.process_at_rank(0);
        loop {
            let _calls = lock(&self.calls);
            if leader.immediate_probe_with_tag(ORDER).is_some() {
                let mut length = [0_u64];
                leader.receive_into_with_tag(&mut length[..], ORDER);
                bytes.clear();
                bytes.resize(length[0] as usize, 0);
                bytes.chunks_mut(MOST).for_each(|part| {
                    leader.receive_into_with_tag(part, ORDER);
                });
                return Ok(());
            }
            drop(_calls);
            if started.elapsed() > EAGER {
                std::thread::sleep(NAP);
            }
        }
    }

    fn send(&self, to: usize, bytes: &[u8]) -> Result<()> {
        let _calls = lock(&self.calls);
        SimpleCommunicator::world().process_at_rank(number(to)).send_with_tag(bytes, MESSAGE);
        Ok(())
    }

    fn receive(&self) -> Result<(usize, Vec<u8>)> {
        loop {
            if let Some(message) = self.try_receive()? {
                return Ok(message);
            }
            std::thread::sleep(NAP);
        }
    }

    fn try_receive(&self) -> Result<Option<(usize, Vec<u8>)>> {
        let _calls = lock(&self.calls);
        let world = SimpleCommunicator::world();
        let found = world.any_process().immediate_matched_probe_with_tag(MESSAGE);
        Ok(found.map(|(message, status)| {
            let from = status.source_rank() as usize;
            let (bytes, _) = (message, status).matched_receive_vec();
            (from, bytes)
        }))
    }

    fn record_traffic(&self, touched: u64) {
        let (traffic, _) = &mut *lock(&self.traffic);
        traffic.steps += 1;
        traffic.touched += touched;
    }
}
