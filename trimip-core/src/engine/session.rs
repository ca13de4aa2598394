//! The two traits through which a program uses a backend that it picks by name: [`Viewer`] renders, [`Session`] also
//! trains.

use crate::{
    Camera, Crop, Error, Frame, Query, Result, ViewSet,
    engine::{batch::Radiance, checkpoint::Checkpoint, events::Totals, poses::Refined},
    field::model::Model,
};

/// Report on one training step. A device that runs ahead reports the latest step that it has finished.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepReport {
    /// Counters of the run after the step.
    pub totals: Totals,
    /// Mean loss.
    pub loss: f64,
    /// PSNR of the step's pixels, in dB.
    pub batch_psnr: f64,
    /// Learning rate of the networks.
    pub learning_rate: f64,
    /// Fraction of the occupancy grid's cells that are occupied.
    pub occupied: f64,
}

/// A model that renders views on some backend. It may be finished or in training; it cannot be trained through this
/// trait.
pub trait Viewer: Send {
    /// Returns the name of the backend.
    fn backend(&self) -> &str;

    /// Returns the name of the device that the backend uses.
    fn device_name(&self) -> String;

    /// Returns one line for each setting that the device cannot honour as written, for the program to show.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// Renders one view on the configured background.
    ///
    /// # Errors
    /// When the picture has more than 2^32 pixels, or the device fails.
    fn render(&mut self, camera: &Camera) -> Result<Frame>;

    /// Renders as [`render`](Self::render) does, and calls `watch` with the number of finished rows and the number of
    /// all rows. In the first call no row is finished. If `watch` returns false, rendering stops and the result is
    /// `None`.
    ///
    /// # Errors
    /// As [`render`](Self::render).
    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>>;

    /// Evaluates density and colour at points of the world and returns one result per query, also where the occupancy
    /// grid is empty and rendering shows nothing.
    ///
    /// # Errors
    /// When the device fails.
    fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>>;

    /// Evaluates only the densities, in the same way as [`query`](Self::query).
    ///
    /// # Errors
    /// When the device fails.
    fn densities(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        Ok(self.query(queries)?.into_iter().map(|radiance| radiance.density).collect())
    }

    /// Returns the encoder's features at points of the world: [queries,
    /// [width](crate::field::encoders::Definition::width)], row by row.
    ///
    /// # Errors
    /// When the device fails, or this viewer has no encoder.
    fn features(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        let _ = queries;
        Err(Error::run("this viewer has no features"))
    }

    /// Returns the number of kept samples of each pixel, summed over its cones. `watch` is as in
    /// [`render_watched`](Self::render_watched).
    ///
    /// # Errors
    /// As [`render`](Self::render), or when this viewer has no samples.
    fn samples(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Vec<u32>>> {
        let _ = (camera, watch);
        Err(Error::run("this viewer has no samples"))
    }

    /// Restricts rendering to the cells of the occupancy grid whose centre is in every part of `keep`; an empty `keep`
    /// restores all cells.
    ///
    /// # Errors
    /// When this viewer cannot leave cells out, for example because its model is in training.
    fn clip(&mut self, keep: &[Crop]) -> Result<()> {
        match keep {
            [] => Ok(()),
            _ => Err(Error::run("this viewer cannot be clipped")),
        }
    }
}

/// A model in training on some backend; it also renders.
pub trait Session: Viewer {
    /// Performs one optimiser step; `progress` in [0, 1] drives the schedules. The caller updates `totals.seconds`.
    ///
    /// # Errors
    /// When the loss of a step is not finite, or the device fails.
    ///
    /// After a loss that is not finite, no checkpoint holds an update with the gradient of that loss. A backend without
    /// lag ([`Backend::LAG`](crate::Backend::LAG) = 0: `"cpu"`) checks the loss before the update: parameters and
    /// moments stay as they were before the step, except for parameters that
    /// [grow](crate::field::encoders::Definition::stage) at the progress of the step. A backend that runs ahead of the
    /// host (`"wgpu"`: by 2 steps) reports the error this number of steps later, after the updates in between. From
    /// then on `step`, [`checkpoint`](Self::checkpoint) and [`finish`](Self::finish) return the same error, until
    /// [`restore`](Self::restore) replaces the state.
    fn step(&mut self, progress: f64) -> Result<StepReport>;

    /// Returns everything that rendering needs.
    ///
    /// # Errors
    /// When the device failed.
    fn model(&mut self) -> Result<Model>;

    /// Returns the model as its file will hold it. This call ends the training; afterwards the session renders this
    /// model.
    ///
    /// # Errors
    /// When the device failed, or an earlier step was not finite, see [`step`](Self::step).
    fn finish(&mut self) -> Result<Model>;

    /// Returns everything that is needed to continue the training with the same bits.
    ///
    /// # Errors
    /// When the device failed, or a step that is in the parameters was not finite, see [`step`](Self::step).
    fn checkpoint(&mut self) -> Result<Checkpoint>;

    /// Takes part in creating the checkpoint of rank 0, without creating one on this rank.
    ///
    /// # Errors
    /// As [`checkpoint`](Self::checkpoint).
    fn join_checkpoint(&mut self) -> Result<()> {
        self.checkpoint().map(drop)
    }

    /// Returns the poses that training has found; `None` unless training refines poses.
    fn refined(&self) -> Option<Refined> {
        None
    }

    /// Returns the cameras of the photographs `views`, moved so that the current model shows them best. The model does
    /// not change.
    ///
    /// # Errors
    /// When the photographs have no pixels, the device fails, or this session cannot align.
    fn align(&mut self, views: ViewSet) -> Result<Vec<Camera>> {
        let _ = views;
        Err(Error::run("this session cannot align cameras"))
    }

    /// Continues from a checkpoint.
    ///
    /// # Errors
    /// When the checkpoint's tensors do not fit the configuration, or the device failed.
    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()>;
}
