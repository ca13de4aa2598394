//! [`Ranks`](trimip_core::exchange::Ranks) over MPI. With the feature `mpi` alone: without it the crate has only
//! [`launched`].

#[cfg(feature = "mpi")]
mod world;
#[cfg(feature = "mpi")]
pub use world::{Traffic, World};

/// Variables of the environment that tell a process how many ranks were launched with it: Open MPI, MPICH and Slurm's PMI.
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];

/// Number of processes that a launcher of MPI programs started together with this one; 1 without a launcher.
pub fn launched() -> usize {
    let size = |name: &&str| std::env::var(name).ok()?.parse().ok();
    SIZES.iter().find_map(size).unwrap_or(1)
}
