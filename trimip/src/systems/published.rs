//! Figures that papers published for the systems, with the known conditions of their measurement. They are quoted,
//! never measured here. PSNR in dB, sizes in megabytes as the papers state them, times in minutes on the papers' GPUs.

use serde::Serialize;

/// The published figures of one system.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Published {
    /// Name in the paper's tables.
    pub name: &'static str,
    /// PSNR at 1/1, 1/2, 1/4 and 1/8, mean of the eight Blender scenes; dB.
    pub scales: Option<[f64; 4]>,
    /// Mean of the four scales and eight scenes, dB.
    pub average: Option<f64>,
    /// SSIM, mean of the four scales and eight scenes.
    pub ssim: Option<f64>,
    /// Mean of the four scales on *lego*, dB.
    pub lego: Option<f64>,
    /// Single-scale PSNR, mean of the eight scenes, dB.
    pub single: Option<f64>,
    /// Single-scale PSNR on *lego*, dB.
    pub single_lego: Option<f64>,
    /// Size of the model, MB.
    pub megabytes: Option<f64>,
    /// Training time on a GPU, minutes.
    pub minutes: Option<f64>,
    /// Splits that it was trained on.
    pub split: &'static str,
    /// Background of its evaluation.
    pub background: &'static str,
    /// Source of the figures.
    pub source: &'static str,
}

/// The sources of the figures.
pub const SOURCES: &str = "Sources: tables 1 and 2 and supplement of Tri-MipRF (ICCV 2023); table 1 of Mip-NeRF (ICCV 2021), which the former \
                           repeats; second-hand notes on arXiv 2405.02386, whose original tables were not seen";

/// How the coarse photographs of all multi-scale figures were averaged.
pub const CONVENTION: &str = "the public multi-scale set: means of straight RGBA, truncated to 8 bits";

/// A row without figures.
const NONE: Published = Published {
    name: "",
    scales: None,
    average: None,
    ssim: None,
    lego: None,
    single: None,
    single_lego: None,
    megabytes: None,
    minutes: None,
    split: "not stated",
    background: "white",
    source: TABLES,
};

const TABLES: &str = "Tri-MipRF";
const MIP_NERF: &str = "Mip-NeRF, Tri-MipRF";
const NOTES: &str = "notes, second-hand";
const BOTH: &str = "train + val (its code)";
const THREE_DAYS: Option<f64> = Some(3.0 * 24.0 * 60.0);

/// Returns a row of the multi-scale table: scales, average, SSIM, *lego*.
const fn multi(name: &'static str, scales: [f64; 4], average: f64, ssim: f64, lego: f64) -> Published {
    Published {
        name,
        scales: Some(scales),
        average: Some(average),
        ssim: Some(ssim),
        lego: Some(lego),
        ..NONE
    }
}

/// Returns a row that is only in the single-scale table: average, *lego*.
const fn single(name: &'static str, average: f64, lego: f64) -> Published {
    Published { name, single: Some(average), single_lego: Some(lego), background: "not stated", ..NONE }
}

/// Every published row, in the order of the tables.
pub const PUBLISHED: &[Published] = &[
    Published {
        minutes: THREE_DAYS,
        split: "train",
        source: MIP_NERF,
        ..multi("NeRF w/o area loss", [31.20, 30.65, 26.25, 22.53], 27.66, 0.927, 27.75)
    },
    Published {
        single: Some(31.74),
        single_lego: Some(33.31),
        megabytes: Some(5.00),
        minutes: THREE_DAYS,
        split: "train",
        source: MIP_NERF,
        ..multi("NeRF", [29.90, 32.13, 33.40, 29.47], 31.23, 0.958, 31.65)
    },
    Published {
        single: Some(33.09),
        single_lego: Some(35.70),
        megabytes: Some(2.50),
        minutes: THREE_DAYS,
        split: "train",
        source: MIP_NERF,
        ..multi("MipNeRF", [32.63, 34.34, 35.47, 35.60], 34.51, 0.973, 35.74)
    },
    Published {
        single: Some(31.71),
        single_lego: Some(34.10),
        megabytes: Some(778.0),
        minutes: Some(9.0),
        ..multi("Plenoxels", [31.60, 32.85, 30.26, 26.63], 30.34, 0.955, 31.26)
    },
    Published {
        single: Some(33.14),
        single_lego: Some(36.46),
        megabytes: Some(71.8),
        minutes: Some(19.0),
        ..multi("TensoRF", [32.11, 33.03, 30.45, 26.80], 30.60, 0.956, 31.73)
    },
    Published {
        single: Some(33.18),
        single_lego: Some(36.39),
        megabytes: Some(64.1),
        minutes: Some(5.0),
        background: "black in its evaluation script",
        ..multi("Instant-ngp", [30.00, 32.15, 33.31, 29.35], 31.20, 0.959, 31.83)
    },
    Published {
        minutes: Some(10.0),
        background: "black in its evaluation script",
        ..multi("Instant-ngp 5×", [30.96, 32.87, 33.10, 30.82], 31.94, 0.963, 32.51)
    },
    Published {
        minutes: Some(4.5),
        split: BOTH,
        ..multi("Tri-MipRF w/o mipmap", [30.25, 32.52, 33.73, 29.44], 31.48, 0.959, 32.09)
    },
    Published {
        single: Some(33.65),
        single_lego: Some(36.15),
        megabytes: Some(48.2),
        minutes: Some(5.0),
        split: BOTH,
        ..multi("Tri-MipRF", [33.32, 35.02, 35.78, 36.13], 35.06, 0.976, 36.51)
    },
    Published {
        average: Some(36.16),
        minutes: Some(32.0),
        split: BOTH,
        background: "not stated",
        source: NOTES,
        name: "Rip-NeRF, 25,000 steps",
        ..NONE
    },
    Published {
        average: Some(37.23),
        megabytes: Some(160.0),
        minutes: Some(156.0),
        split: BOTH,
        background: "not stated",
        source: NOTES,
        name: "Rip-NeRF",
        ..NONE
    },
    Published {
        average: Some(36.69),
        megabytes: Some(592.0),
        minutes: Some(270.0),
        background: "not stated",
        source: NOTES,
        name: "Zip-NeRF",
        ..NONE
    },
    single("SRN", 22.26, 20.85),
    single("LLFF", 24.88, 24.54),
    single("Neural Volumes", 26.05, 26.08),
    Published { megabytes: Some(612.0), ..single("DVGO", 31.95, 34.64) },
];

/// Remarks on the published figures; one statement each.
pub const REMARKS: &[&str] = &[
    "The rows NeRF and MipNeRF equal Mip-NeRF's own table. “w/o area loss” also lacks the centring of rays in their pixels: with the \
     area loss alone NeRF has 27.82 dB, with centred rays too 31.22 dB, with all changes 31.23 dB. The half pixel gives 3.4 of the \
     3.57 dB. MipNeRF without the area loss has 32.98 dB.",
    "Mip-NeRF trains on the split train; the code of Tri-MipRF trains on train and val. On lego, with train alone, Tri-MipRF's code \
     has 35.72 dB and MipNeRF 35.74 dB. All systems that are measured here train on one split, stated at the head of the page.",
    "Instant-ngp's evaluation script uses a black background, and its training random backgrounds. With white in both, its single-scale figures \
     are 35.87 dB on lego and 32.35 dB in the mean (nerfacc). All systems that are measured here are evaluated on one background.",
    "The 64.1 MB of Instant-ngp are probably 16 · 2¹⁹ · 2 numbers of four bytes; its real tables have 46.5 MiB, because coarse levels \
     have fewer corners.",
    "LPIPS, which the paper's tables have, needs weights that this program does not ship: eval.lpips names a file of them.",
    "NeRF and MipNeRF took three days, the others minutes, each on a GPU of its paper. Times that are measured here are those of one \
     machine; published points are drawn apart.",
];

/// Returns the published row with this name.
pub fn find(name: &str) -> Option<&'static Published> {
    PUBLISHED.iter().find(|published| published.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_are_those_of_their_scales() {
        for row in PUBLISHED {
            if let (Some(scales), Some(average)) = (row.scales, row.average) {
                let mean = scales.iter().sum::<f64>() / 4.0;
                // The tables round to a hundredth.
                assert!((mean - average).abs() < 0.011, "{}: {mean} and {average}", row.name);
            }
            assert!(!row.name.is_empty() && !row.source.is_empty());
            assert_eq!(find(row.name), Some(row), "{} is there once", row.name);
        }
    }
}
