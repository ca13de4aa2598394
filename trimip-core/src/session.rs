//! The one door between static backends and a program that picks one by name.

use crate::{Camera, Frame, Result, checkpoint::Checkpoint, events::Totals, model::Model};

/// What one training step did; on a device that runs ahead, what the latest finished one did.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepReport {
    /// Counters of the run after the step.
    pub totals: Totals,
    /// Mean loss.
    pub loss: f64,
    /// PSNR of the step's own pixels, dB.
    pub batch_psnr: f64,
    /// Learning rate of the networks.
    pub learning_rate: f64,
    /// Share of occupied cells.
    pub occupied: f64,
}

/// A model in training, or a finished one to render, on some backend.
pub trait Session: Send {
    /// Name of the backend.
    fn backend(&self) -> &str;

    /// The device that stands behind that name.
    fn device_name(&self) -> String;

    /// Settings that the device takes otherwise than they read, one line each: a run says them.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// One optimiser step; `progress` in [0, 1] drives the schedules. `totals.seconds` is the caller's to keep.
    ///
    /// # Errors
    /// When a loss or gradient is no longer finite, or the device fails; the parameters are then those before the step.
    fn step(&mut self, progress: f64) -> Result<StepReport>;

    /// Renders one view on the configured background.
    fn render(&mut self, camera: &Camera) -> Result<Frame>;

    /// As [`render`](Self::render); `watch` is told how many rows of how many are done, first none, and returns false to
    /// give the view up, which makes it `None`.
    ///
    /// # Errors
    /// As [`render`](Self::render).
    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>>;

    /// Everything `render` needs.
    fn model(&mut self) -> Result<Model>;

    /// The model as its file will hold it, which this session renders from now on: training is over.
    ///
    /// # Errors
    /// When the device failed.
    fn finish(&mut self) -> Result<Model>;

    /// Everything training needs to go on with the same bits.
    fn checkpoint(&mut self) -> Result<Checkpoint>;

    /// Goes on from a checkpoint.
    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()>;
}
