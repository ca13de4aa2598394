//! The two doors between static backends and a program that picks one by name: what renders, and what trains as well.

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

/// A model that renders views on some backend. It may be a finished one or one in training; it cannot be trained through
/// this trait.
pub trait Viewer: Send {
    /// Name of the backend.
    fn backend(&self) -> &str;

    /// The device behind that name.
    fn device_name(&self) -> String;

    /// Settings that the device does not follow as they are written, one line each. A program shows them.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// Renders one view on the configured background.
    ///
    /// # Errors
    /// When the picture has more than 2^32 pixels, or the device fails.
    fn render(&mut self, camera: &Camera) -> Result<Frame>;

    /// As [`render`](Self::render). `watch` is called with the number of finished rows and the number of all rows, first
    /// with none finished. Where it returns false the view is given up and the result is `None`.
    ///
    /// # Errors
    /// As [`render`](Self::render).
    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>>;
}

/// A model in training on some backend; it renders as well.
pub trait Session: Viewer {
    /// One optimiser step; `progress` in [0, 1] drives the schedules. `totals.seconds` is the caller's to keep.
    ///
    /// # Errors
    /// When a loss or gradient is no longer finite, or the device fails; the parameters are then those before the step.
    fn step(&mut self, progress: f64) -> Result<StepReport>;

    /// Everything that rendering needs.
    ///
    /// # Errors
    /// When the device failed.
    fn model(&mut self) -> Result<Model>;

    /// The model as its file will hold it. The session renders this model from now on: training is over.
    ///
    /// # Errors
    /// When the device failed.
    fn finish(&mut self) -> Result<Model>;

    /// Everything that training needs to go on with the same bits.
    ///
    /// # Errors
    /// When the device failed, or a step under way was not finite.
    fn checkpoint(&mut self) -> Result<Checkpoint>;

    /// Goes on from a checkpoint.
    ///
    /// # Errors
    /// When its tensors do not fit the configuration, or the device failed.
    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()>;
}
