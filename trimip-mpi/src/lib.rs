//! [`Ranks`](trimip_core::engine::exchange::Ranks) over MPI, with the feature `mpi`. Without it the crate has only
//! [`launched`].

#[cfg(feature = "mpi")]
mod world;
#[cfg(feature = "mpi")]
pub use world::{Traffic, World};

use trimip_core::engine::exchange::Rank;

/// Environment variables in which a launcher passes a process its rank and the number of ranks: `mpirun` of Open MPI, the
/// PMI of MPICH and Slurm, and PMIx under Slurm.
const LAUNCHERS: [[&str; 2]; 3] = [
    ["OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"],
    ["PMI_RANK", "PMI_SIZE"],
    ["PMIX_RANK", "SLURM_STEP_NUM_TASKS"],
];

/// Returns the rank of this process among those that an MPI launcher started together; [`Rank::ONLY`] without a
/// launcher.
pub fn launched() -> Rank {
    let read = |name: &str| std::env::var(name).ok()?.parse().ok();
    let told = |[rank, of]: [&str; 2]| Some(Rank { id: read(rank)?, size: read(of)? });
    LAUNCHERS.into_iter().find_map(told).unwrap_or(Rank::ONLY)
}
