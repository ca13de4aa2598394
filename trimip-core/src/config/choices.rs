//! Settings that are one of a few named values.

use serde::{Deserialize, Serialize};

/// Declares an enum of named values, which configurations write in lower case.
macro_rules! choice {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident),* $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        pub enum $name { $($(#[$doc])* $variant),* }
    };
}

choice!(
    /// How RGBA is averaged to coarser scales.
    Convention {
        /// Means of straight RGBA, truncated to 8 bits, as in the public multi-scale set.
        Public,
        /// Means of premultiplied RGBA, correct at silhouettes.
        Premultiplied,
    }
);
choice!(
    /// How space beyond the scene's box is mapped.
    Contraction {
        /// Space beyond the box is left out.
        None,
        /// All of space is contracted into the box, except a ball in the middle of the box, which stays uncontracted
        /// (mip-NeRF 360).
        Ball,
    }
);
choice!(
    /// Names of the renderers.
    RendererKind {
        /// Volume rendering with ray marching in uniform steps.
        Volume,
        /// Pictures are rendered with few samples, near the surfaces that the model's proxy shows. Training, and rays for
        /// which the proxy is unsure, use volume rendering.
        Hybrid,
    }
);
choice!(
    /// How the hybrid renderer places samples.
    HybridRule {
        /// Where the proxy predicts weight for the steps of a ray.
        Weight,
        /// A given number of samples around each surface that a ray enters (paper).
        Layers,
    }
);
choice!(
    /// How a pixel is divided into cones.
    ConePattern {
        /// Into a grid of square parts with one cone each.
        Grid,
        /// Into five cones as wide as the pixel: one at its centre and four half-way to its corners.
        Quincunx,
    }
);
choice!(
    /// Factors of the products whose sum is a tensor (TensoRF).
    Decomposition {
        /// A plane and the line perpendicular to it.
        Vm,
        /// Three lines.
        Cp,
    }
);
choice!(
    /// Map from a density logit to a density.
    DensityFunction {
        /// exp(logit − shift).
        Exp,
        /// ln(1 + exp(logit − shift)).
        Softplus,
        /// max(0, logit − shift).
        Relu,
    }
);
choice!(
    /// How the viewing direction is encoded for the colour network.
    ViewEncoding {
        /// Real spherical harmonics.
        Harmonics,
        /// The coordinates, and their sines and cosines at rising frequencies (NeRF, Eq. 4, without π).
        Frequencies,
        /// The weights of soft Voronoi cells around 16 unit sites.
        Voronoi,
    }
);
choice!(
    /// Number of texels along the sides of a plane.
    PlaneShape {
        /// `plane_size` along both sides: the planes are stretched over the box, whatever its shape (paper).
        Square,
        /// `plane_size` along the longest side of the box and fewer along the other sides, so that texels are square.
        Box,
    }
);
choice!(
    /// What happens to a run that is predicted to need more memory than is available.
    MemoryChoice {
        /// The run does not begin.
        Refuse,
        /// The run begins with a warning.
        Warn,
    }
);
choice!(
    /// Whether a decision of the scene plan is taken.
    PlanChoice {
        /// The decision is taken unless the user set a value that it decides.
        Auto,
        /// The decision is always taken, even for values that the user set. If it cannot be taken, the plan fails.
        On,
        /// The decision is never taken.
        Off,
    }
);
choice!(
    /// Precision of the planes in a model file.
    FilePrecision {
        /// 32 bits, as trained.
        F32,
        /// 16 bits.
        F16,
    }
);
choice!(
    /// Base radius in the mip level's formula (Tri-MipRF Eq. 5).
    LevelFormula {
        /// texel/√π, the radius of a disc with the texel's area.
        Paper,
        /// texel/2.
        Code,
    }
);
choice!(
    /// Precision of the operands of matrix products. Sums and parameters are f32.
    Precision {
        /// 24 significant bits.
        F32,
        /// 8 significant bits, for CPUs; twice as fast with AVX-512 BF16.
        Bf16,
        /// 11 significant bits and numbers up to 65,504, for GPUs with cooperative matrices.
        F16,
    }
);
choice!(
    /// Rays over which the loss is averaged.
    LossRays {
        /// Rays with at least one kept sample.
        Live,
        /// Every ray of the batch.
        All,
    }
);

choice!(
    /// Exposure of the training photographs.
    Exposure {
        /// All photographs have the same exposure.
        None,
        /// Each photograph has one gain per channel, see [`exposure`](crate::engine::exposure).
        Gain,
    }
);

choice!(
    /// Treatment of the poses of training photographs.
    CameraPoses {
        /// Poses stay as given.
        Fixed,
        /// Poses are trained together with the model, see [`poses`](crate::engine::poses).
        Refine,
    }
);

choice!(
    /// Background that training rays are composited on.
    TrainBackground {
        /// `data.background`.
        Fixed,
        /// A colour drawn for each ray.
        Random,
    }
);
choice!(
    /// How the learning rate falls.
    RateSchedule {
        /// By a factor at each milestone.
        Milestones,
        /// Along half a period of a cosine.
        Cosine,
        /// Exponentially. The decay restarts each time the encoder grows, if the encoder requests that.
        Exponential,
    }
);
choice!(
    /// How AdamW treats texels that have no gradient in a step.
    Untouched {
        /// The same as with a gradient: the moments decay and the parameter is updated.
        Decay,
        /// Moments and parameters are left unchanged.
        Skip,
    }
);

/// The final evaluation: a stride over the test views, or a flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FinalEval {
    /// `true`: every `eval.stride`-th view; `false`: none.
    Flag(bool),
    /// Every n-th view; 0: none.
    Stride(u32),
}
