//! A viewer for pages without a server: the renderer of trimip-wgpu as WebAssembly, over the browser's WebGPU.
//! `tools/web.sh` builds it; `trimip-cli export web` writes a folder with it, a model and the page in `trimip-cli/page`.
#![cfg(target_family = "wasm")]

use glam::{DMat3, DVec3};
use serde_json::json;
use trimip_core::engine::loaded::LoadedModel;
use trimip_core::field::model::Model;
use trimip_core::scene::origin::LocalOrigin;
use trimip_core::{Camera, Crop, Error, Intrinsics, Viewer as _};
use trimip_wgpu::WgpuBackend;
use wasm_bindgen::prelude::*;

/// A model on the browser's GPU.
#[wasm_bindgen]
pub struct Viewer {
    loaded: LoadedModel<WgpuBackend>,
    crop: Crop,
    /// True while pictures show only the crop.
    cropped: bool,
    about: String,
}

fn thrown(error: Error) -> JsError {
    JsError::new(&error.message())
}

#[wasm_bindgen]
impl Viewer {
    /// Loads a model from the bytes of its file.
    ///
    /// # Errors
    /// When the bytes are not a model, or the browser has no GPU that can render it.
    pub async fn load(bytes: Vec<u8>) -> Result<Viewer, JsError> {
        let mut model = Model::from_bytes("the model", &bytes).map_err(thrown)?;
        drop(bytes);
        model.config.renderer.kind = trimip_core::config::RendererKind::Volume;
        let scene = &model.config.scene;
        let crop = scene.crop;
        let about = json!({
            "box": { "min": scene.aabb_min, "max": scene.aabb_max },
            "up": scene.up,
            "crop": LocalOrigin::of(&model.config.data).stated(crop),
            "background": model.config.data.background,
        })
        .to_string();
        let loaded = trimip_wgpu::load_async(&model, "").await.map_err(thrown)?;
        Ok(Self { loaded, crop, cropped: false, about })
    }

    /// Returns the scene's box, up direction, crop (in the coordinates of the photographs) and background, as JSON.
    pub fn about(&self) -> String {
        self.about.clone()
    }

    /// Renders a view. `pose` is a camera-to-world matrix [R|t] of 12 numbers row by row, OpenGL axes; `fov` is horizontal, in
    /// degrees. If `cropped` is true, only the crop of the model is shown. Returns RGBA, 8 bits each, row by row.
    ///
    /// # Errors
    /// When `pose`, `fov` or the size is invalid, or the device fails.
    pub async fn render(
        &mut self,
        pose: Vec<f64>,
        fov: f64,
        width: u32,
        height: u32,
        cropped: bool,
    ) -> Result<Vec<u8>, JsError> {
        if pose.len() != 12 || !(fov > 0.0 && fov < 180.0) || width == 0 || height == 0 {
            return Err(JsError::new("expected 12 numbers, a field of view and a size"));
        }
        let column = |c: usize| DVec3::new(pose[c], pose[4 + c], pose[8 + c]);
        let camera = Camera {
            intrinsics: Intrinsics::from_angle(width, height, fov.to_radians()),
            rotation: DMat3::from_cols(column(0), column(1), column(2)),
            origin: column(3),
        };
        if cropped != self.cropped {
            let keep = [self.crop];
            self.loaded.clip(if cropped { &keep } else { &[] }).map_err(thrown)?;
            self.cropped = cropped;
        }
        let frame = self.loaded.render_async(&camera).await.map_err(thrown)?;
        let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
        Ok(frame
            .pixels
            .iter()
            .flat_map(|pixel| {
                let [r, g, b] = pixel.rgb.map(byte);
                [r, g, b, 255]
            })
            .collect())
    }
}
