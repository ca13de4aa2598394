//! The session through which rank 0 leads a training.

use super::orders::{Opened, Order, computes_with};
use crate::{backends, machine};
use std::sync::Arc;
use trimip_core::{
    Camera, Config, Error, Frame, Query, Result, Session, StepReport, ViewSet, Viewer,
    engine::{batch::Radiance, checkpoint::Checkpoint, exchange::Ranks, poses::Refined},
    field::model::Model,
    scene::fingerprint::Fingerprint,
};

/// A session of rank 0 that all ranks share.
struct Lead {
    session: Box<dyn Session>,
    ranks: Arc<dyn Ranks>,
}

/// Like [`backends::train`], on all ranks: rank 0 calls this function, while the others [`follow`](super::follow).
///
/// # Errors
/// As [`backends::train_over`].
pub fn train(config: &Config, views: ViewSet, ranks: &Arc<dyn Ranks>) -> Result<Box<dyn Session>> {
    let data = Fingerprint::of(&views);
    let session = backends::train_over(config, views, Arc::clone(ranks))?;
    let computes = computes_with(config, ranks.on_machine())?;
    Order::Train { version: machine::version(), config: config.to_toml(), data, computes }.give(&**ranks)?;
    // Closes the session on all ranks when dropped, also if one of them cannot open it.
    let lead: Box<dyn Session> = Box::new(Lead { session, ranks: Arc::clone(ranks) });
    // Waits for all ranks, so that the time of the first step does not include the time in which they read their data.
    let mut refused = None;
    for _ in 1..ranks.rank().size {
        let (rank, answer) = ranks.receive()?;
        let opened: Opened = serde_json::from_slice(&answer).map_err(Error::run)?;
        refused = refused.or(opened.err().map(|error| error.of_rank(rank)));
    }
    refused.map_or(Ok(lead), Err)
}

impl Drop for Lead {
    fn drop(&mut self) {
        // A rank that is gone needs no order.
        let _ = Order::Close.give(&*self.ranks);
    }
}

impl Viewer for Lead {
    fn backend(&self) -> &str {
        self.session.backend()
    }

    fn device_name(&self) -> String {
        format!("{} ranks, each {}", self.ranks.rank().size, self.session.device_name())
    }

    fn notes(&self) -> Vec<String> {
        self.session.notes()
    }

    fn render(&mut self, camera: &Camera) -> Result<Frame> {
        self.session.render(camera)
    }

    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        self.session.render_watched(camera, watch)
    }

    fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
        self.session.query(queries)
    }

    fn densities(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        self.session.densities(queries)
    }

    fn features(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        self.session.features(queries)
    }

    fn samples(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Vec<u32>>> {
        self.session.samples(camera, watch)
    }
}

impl Session for Lead {
    fn step(&mut self, progress: f64) -> Result<StepReport> {
        Order::Step(progress).give(&*self.ranks)?;
        self.session.step(progress)
    }

    fn model(&mut self) -> Result<Model> {
        self.session.model()
    }

    fn finish(&mut self) -> Result<Model> {
        self.session.finish()
    }

    fn checkpoint(&mut self) -> Result<Checkpoint> {
        Order::Checkpoint.give(&*self.ranks)?;
        self.session.checkpoint()
    }

    fn refined(&self) -> Option<Refined> {
        self.session.refined()
    }

    fn align(&mut self, views: ViewSet) -> Result<Vec<Camera>> {
        // Only on rank 0: the other ranks take no part in an evaluation.
        self.session.align(views)
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        // If rank 0 refuses the checkpoint, the others need not receive it.
        self.session.restore(checkpoint)?;
        Order::Restore.give(&*self.ranks)?;
        self.ranks.broadcast(&mut checkpoint.to_bytes()?)
    }
}
