//! Checks of jobs that rank 0 distributes, on ranks that are threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use trimip::ranks::{dismiss, follow, scatter_jobs, work_on_jobs};
use trimip_core::engine::exchange::Ranks;
use trimip_core::{Error, Result};
use trimip_tests::ranks::Threads;

const WHAT: &str = "squares";

/// Runs `lead` as rank 0 of `count`; the other ranks do jobs with `own`.
fn with_others(
    count: usize,
    own: impl Fn(usize) -> Result<usize> + Sync,
    lead: impl FnOnce(&dyn Ranks) -> Result<()>,
) -> Result<()> {
    let mut ranks = Threads::new(count).into_iter();
    let first = ranks.next().expect("a first rank");
    std::thread::scope(|scope| {
        for rank in ranks {
            let (rank, own): (Arc<dyn Ranks>, _) = (rank, &own);
            scope.spawn(move || {
                follow(&rank, &mut |ranks| work_on_jobs(ranks, WHAT, own), &mut |text| panic!("{text}"))
                    .expect("it follows to the end");
            });
        }
        let outcome = lead(&*first);
        dismiss(&*first).expect("the others are there");
        outcome
    })
}

/// Returns true if `taken` holds the jobs with their squares, in order.
fn squares(jobs: &[usize], taken: &[(usize, usize)]) -> bool {
    jobs.iter().map(|job| (*job, job * job)).eq(taken.iter().copied())
}

#[test]
fn results_come_in_the_order_of_the_jobs() {
    for (count, jobs) in [(2, 0..40), (3, 5..9), (4, 0..1), (5, 0..0)] {
        let jobs: Vec<usize> = jobs.rev().collect();
        let mut taken = Vec::new();
        // In each group of four jobs, later ones are quicker.
        let own = |job: usize| {
            std::thread::sleep(Duration::from_millis(job as u64 % 4));
            Ok(job * job)
        };
        let take = |job, result| {
            taken.push((job, result));
            Ok(true)
        };
        with_others(count, own, |ranks| scatter_jobs(ranks, WHAT, &jobs, &|| true, own, take))
            .expect("all is done");
        assert!(squares(&jobs, &taken), "{count} ranks: {taken:?}");
    }
}

#[test]
fn other_ranks_work_on_while_rank_0_has_a_long_job() {
    let jobs: Vec<usize> = (0..20).collect();
    let (done, mut taken) = (AtomicUsize::new(0), Vec::new());
    let theirs = |job: usize| {
        done.fetch_add(1, Ordering::SeqCst);
        Ok(job * job)
    };
    let own = |job: usize| {
        // Job 0 ends only when all others are done.
        while job == 0 && done.load(Ordering::SeqCst) < 19 {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(job * job)
    };
    let take = |job, result| {
        taken.push((job, result));
        Ok(true)
    };
    with_others(3, theirs, |ranks| scatter_jobs(ranks, WHAT, &jobs, &|| true, own, take))
        .expect("all is done");
    assert!(squares(&jobs, &taken), "{taken:?}");
}

#[test]
fn a_job_that_fails_is_told_with_its_rank() {
    let jobs: Vec<usize> = (0..9).collect();
    let failed = AtomicBool::new(false);
    let theirs = |_| {
        failed.store(true, Ordering::SeqCst);
        Err(Error::input("photograph 1", "is no picture", "replace it"))
    };
    let own = |job: usize| {
        while !failed.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(job * job)
    };
    let error =
        with_others(2, theirs, |ranks| scatter_jobs(ranks, WHAT, &jobs, &|| true, own, |_, _| Ok(true)))
            .expect_err("a job fails");
    assert!(
        error.kind() == trimip_core::ErrorKind::Input && error.message().starts_with("rank 1: photograph 1"),
        "{error}"
    );
}

#[test]
fn no_job_is_handed_out_after_a_stop() {
    let jobs: Vec<usize> = (0..1000).collect();
    let (going, begun) = (AtomicBool::new(true), AtomicUsize::new(0));
    // Job 3 stops all jobs. Until then, job 0 and the jobs after 3 wait.
    let own = |job: usize| {
        begun.fetch_add(1, Ordering::SeqCst);
        if job == 3 {
            going.store(false, Ordering::SeqCst);
        }
        while (job == 0 || job > 3) && going.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(job)
    };
    let take = |_, _| Ok(true);
    with_others(3, own, |ranks| {
        scatter_jobs(ranks, WHAT, &jobs, &|| going.load(Ordering::SeqCst), own, take)
    })
    .expect("a stop is no error");
    // Jobs 0 to 4, and at most one more on each of the two other ranks.
    assert!(begun.load(Ordering::SeqCst) <= 7, "{begun:?} jobs were begun");
}

#[test]
fn a_rank_with_other_jobs_refuses() {
    let mut ranks = Threads::new(2).into_iter();
    let (first, other) = (ranks.next().expect("rank 0"), ranks.next().expect("rank 1"));
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let other: Arc<dyn Ranks> = other;
            let own = |_| -> Result<usize> { panic!("no job of others is done") };
            follow(&other, &mut |ranks| work_on_jobs(ranks, "cubes", own), &mut |text| panic!("{text}"))
                .expect("rank 0 tells the error");
        });
        let jobs: Vec<usize> = (0..9).collect();
        let refused = scatter_jobs(&*first, WHAT, &jobs, &|| true, Ok::<usize, _>, |_, _| Ok(true))
            .expect_err("these are other jobs");
        let part = "rank 1: the jobs of this rank: are not those of rank 0";
        assert!(
            refused.kind() == trimip_core::ErrorKind::Input && refused.message().starts_with(part),
            "{refused}"
        );
        dismiss(&*first).expect("rank 1 is there");
    });
}
