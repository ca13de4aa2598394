//! Settings that are one of a few named values.

use serde::{Deserialize, Serialize};

/// Declares a named choice, written in lower case.
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
        /// It is left out.
        None,
        /// All of space is contracted into the box; a ball in its middle keeps its shape (mip-NeRF 360).
        Ball,
    }
);
choice!(
    /// The renderers by name.
    RendererKind {
        /// Ray marching in uniform steps, and volume rendering.
        Volume,
        /// Pictures take few samples, where the model's proxy shows surfaces. Training, and rays for which the proxy is
        /// unsure, use volume rendering.
        Hybrid,
    }
);
choice!(
    /// How the hybrid renderer places samples.
    HybridRule {
        /// By the weight that the proxy predicts for each step of a ray.
        Weight,
        /// A number of samples around each surface that a ray enters (paper).
        Layers,
    }
);
choice!(
    /// How a pixel is divided into cones.
    ConePattern {
        /// Into a grid of square parts.
        Grid,
        /// Into five cones of its own width: in its centre and half-way to its corners.
        Quincunx,
    }
);
choice!(
    /// Factors of the products whose sum is a tensor.
    Decomposition {
        /// Planes and the lines across them.
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
    /// How the colour network sees the viewing direction.
    ViewEncoding {
        /// By real spherical harmonics.
        Harmonics,
        /// By its coordinates, and their sines and cosines at rising frequencies (NeRF, Eq. 4, without π).
        Frequencies,
    }
);
choice!(
    /// Texels of a plane.
    PlaneShape {
        /// `plane_size` along both sides, whatever the box: the planes are stretched over it (paper).
        Square,
        /// `plane_size` along the longest side of the box, fewer along the others, so that texels are square.
        Box,
    }
);
choice!(
    /// What happens to a run that is predicted to need more memory than is available.
    MemoryChoice {
        /// It does not begin.
        Refuse,
        /// It begins with a warning.
        Warn,
    }
);
choice!(
    /// Whether a decision of the scene plan is taken.
    PlanChoice {
        /// Unless the user set the value.
        Auto,
        /// Always, even for values that the user set; an error if it cannot be decided.
        On,
        /// Never.
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
    /// Precision of the factors of the matrix products; sums and parameters are f32.
    Precision {
        /// 24 significant bits.
        F32,
        /// 8 significant bits, for CPUs; twice as fast with AVX-512 BF16.
        Bf16,
        /// 11 significant bits, up to 65,504, for GPUs with cooperative matrices.
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
        /// The same for all photographs.
        None,
        /// Each photograph has one gain per channel, see [`exposure`](crate::engine::exposure).
        Gain,
    }
);

choice!(
    /// Treatment of the poses of training photographs.
    CameraPoses {
        /// They stay as given.
        Fixed,
        /// They are trained with the model, see [`poses`](crate::engine::poses).
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
        /// Along half a cosine.
        Cosine,
        /// Exponentially; restarts whenever an encoder that asks for it grows.
        Exponential,
    }
);
choice!(
    /// AdamW for texels without a gradient in a step.
    Untouched {
        /// As for all others: the moments decay and the parameter is updated.
        Decay,
        /// They are left unchanged.
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
