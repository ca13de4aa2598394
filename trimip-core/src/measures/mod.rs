//! Measures of pictures: PSNR, SSIM and MS-SSIM ([`metrics`]), their means over views and scales ([`quality`]), and the interface of
//! perceptual metrics ([`perception`]).

pub mod metrics;
pub mod perception;
pub mod quality;
