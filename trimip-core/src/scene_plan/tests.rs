//! Tests of whole plans for small scenes.

mod budgets;
mod places;

use super::*;
use crate::config::{Contraction, EncoderKind, FilePrecision};
use crate::field::encoders::tri_mip::Pyramid;
use crate::scene::{cones::PixelPattern, depths::KnownDepth, origin::LocalOrigin};
use crate::{Aabb, Alpha, Camera, Intrinsics, Scale, View, ViewSet};
use glam::DVec3;

/// Returns sixteen views of a ball of radius 0.4 around (0.5, 0, 0), at two scales.
pub(super) fn views(alpha: bool) -> ViewSet {
    views_of(alpha, 16)
}

/// Returns `count` such views. Sixteen have 2^20 pixels at the finest scale.
fn views_of(alpha: bool, count: u32) -> ViewSet {
    let mut set = ViewSet {
        views: Vec::new(),
        pixels: Default::default(),
        alpha: Alpha::Straight,
        scales: Vec::new(),
        depths: Vec::new(),
    };
    for level in 0..2_u32 {
        let k = Intrinsics::from_angle(256, 256, 0.7).reduced(level);
        let (first, first_pixel) = (set.views.len(), set.pixels.len());
        for i in 0..count {
            let turn = f64::from(i) * 2.4;
            let origin = 4.0 * DVec3::new(turn.cos(), turn.sin(), 0.5 - f64::from(i % 3) * 0.5);
            let camera = Camera::look_at(k, origin, DVec3::ZERO, DVec3::Z);
            set.views.push(View { name: i.to_string(), camera, offset: set.pixels.len() });
            for (y, x) in (0..k.height).flat_map(|y| (0..k.width).map(move |x| (y, x))) {
                let cone = camera.cone::<f64>(x, y);
                let to = DVec3::new(0.5, 0.0, 0.0) - DVec3::from_array(cone.origin);
                let along = to.dot(DVec3::from_array(cone.direction));
                let hit = to.length_squared() - along * along < 0.16;
                set.pixels.push([255, 0, 0, if hit || !alpha { 255 } else { 0 }]);
            }
        }
        set.scales.push(Scale {
            factor: 1 << level,
            weight: (1 << (2 * level)) as f32,
            views: first..set.views.len(),
            pixels: first_pixel..set.pixels.len(),
        });
    }
    set
}

fn planned(train: &ViewSet, set: &[&str]) -> Result<(Config, Vec<Finding>)> {
    let mut settings = Settings::defaults();
    set.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
    let test: Vec<Camera> = train.views.iter().map(|view| view.camera).collect();
    let compute = Compute::one_thread();
    let facts = Facts { train, test: &test, stated: None, origin: LocalOrigin::default(), compute: &compute };
    let findings = make(&mut settings, &facts)?;
    Ok((Config::from_settings(&settings)?, findings))
}

/// Returns the finding of a decision.
fn of<'a>(findings: &'a [Finding], decision: &str) -> &'a Finding {
    findings.iter().find(|finding| finding.decision == decision).unwrap()
}

#[test]
fn levels_are_sharper_where_texels_are_as_fine_as_pixels_see() {
    let bias = |set: &[&str]| planned(&views(true), set).unwrap().0.encoder.level_bias;
    assert_eq!(bias(&[]), -0.5);
    // Planes of 16 texels over the ball: each texel is about as wide as five pixels.
    assert_eq!(bias(&["encoder.plane_size=16", "encoder.levels=3"]), 0.0);
    assert_eq!(bias(&["encoder.level_bias=0.25"]), 0.25, "a setting that is given stays");
}

#[test]
fn cones_are_about_as_wide_as_pixels_of_the_finest_photographs() {
    let train = views(true);
    let (config, _) = planned(&train, &[]).unwrap();
    let footprint = fineness::footprint(&train, &Aabb::new(&config.scene)).unwrap();
    let width = f64::from(config.renderer.cone_width) / footprint;
    assert!((width / 1.25 - 1.0).abs() < 5e-3, "{width}");
    let division = crate::scene::cones::Division::new(&config);
    assert_eq!(division.patterns(&train), [1, 2].map(PixelPattern::Grid));
    let aabb = Aabb::new(&config.scene);
    let away = |view: &&View| (crate::scene::cones::footprint(&view.camera, &aabb) - footprint).abs();
    let median = train.views[..16].iter().min_by(|a, b| away(a).total_cmp(&away(b)));
    let camera = median.unwrap().camera;
    let at = |level| division.pattern(&Camera { intrinsics: camera.intrinsics.reduced(level), ..camera });
    assert_eq!([0, 1, 2, 3, 4].map(at), [1, 2, 3, 4, 4].map(PixelPattern::Grid));
    let (config, findings) = planned(&train, &["renderer.cones=1"]).unwrap();
    assert_eq!(
        (config.renderer.cones, config.renderer.cone_width),
        (1, 0.0),
        "a setting that is given stays"
    );
    assert!(of(&findings, "cones").reason.contains("renderer.cones"));
}

#[test]
fn edge_exponents_are_those_of_the_photographs() {
    let exponents = |train: &ViewSet, set: &[&str]| planned(train, set).unwrap().0.data.edge_exponents;
    let mut train = views(true);
    // Means of straight colours in which transparent pixels are black: colour times alpha is P·A.
    for i in train.scales[1].views.clone() {
        let (fine, coarse) = (i - train.scales[1].views.start, train.views[i].offset);
        let means = train.means(fine, 2);
        for (pixel, [.., alpha]) in train.pixels[coarse..].iter_mut().zip(means) {
            *pixel = [(255.0 * alpha) as u8, 0, 0, (255.0 * alpha) as u8];
        }
    }
    let found = exponents(&train, &[]);
    assert!(found.len() == 2 && found[0] == 0.0 && (found[1] - 1.0).abs() < 0.03, "{found:?}");
    assert!(exponents(&train, &["plan.edges=off"]).is_empty());
    assert_eq!(exponents(&train, &["data.edge_exponents=[0.0, 0.5]"]), [0.0, 0.5]);
    assert!(exponents(&views(false), &[]).is_empty(), "photographs without alpha");
    train.alpha = Alpha::Premultiplied;
    assert!(exponents(&train, &[]).is_empty(), "premultiplied colours are right at silhouettes");
}

#[test]
fn a_hash_grid_is_as_fine_as_pixels_see_and_has_no_settings_of_planes() {
    let train = views(true);
    let (config, findings) = planned(&train, &["encoder.kind=hash-grid"]).unwrap();
    let aabb = Aabb::<f64>::new(&config.scene);
    let footprint = fineness::footprint(&train, &aabb).unwrap();
    let width = aabb.longest() / f64::from(config.hash_grid.finest) / footprint;
    assert!((1.2..=1.3).contains(&width), "{width}");
    let changes = || findings.iter().flat_map(|finding| &finding.changes);
    assert!(changes().any(|change| change.path == "hash_grid.finest"));
    assert!(changes().all(|change| !change.path.starts_with("encoder.")), "{findings:?}");
    let given = planned(&train, &["encoder.kind=hash-grid", "hash_grid.finest=1024"]).unwrap().0;
    assert_eq!(given.hash_grid.finest, 1024, "a setting that is given stays");
}

#[test]
fn ripmaps_are_as_fine_as_planes_and_have_the_levels_that_cameras_need() {
    let train = views(true);
    let (config, _) = planned(&train, &["encoder.kind=rip-map"]).unwrap();
    let [planes, ripmaps] = [planned(&train, &[]).unwrap().0, config]
        .map(|config| [config.encoder.plane_size, config.rip_map.size, config.rip_map.levels]);
    assert!(
        ripmaps[1] < 512 && ripmaps[1].abs_diff(planes[0]) <= 16,
        "texels of {ripmaps:?}, planes {planes:?}"
    );
    assert!((1..8).contains(&ripmaps[2]), "the levels that the cameras need: {ripmaps:?}");
    let given = planned(&train, &["encoder.kind=rip-map", "rip_map.levels=7"]).unwrap().0;
    assert_eq!(given.rip_map.levels, 7, "a setting that is given stays");
}

/// Checks that the plan reports only what it sets.
#[test]
fn the_budget_says_nothing_of_the_settings_of_another_encoder() {
    let train = views(true);
    for (kind, levels) in [("tri-mip", true), ("hash-grid", false), ("rip-map", false)] {
        let (config, findings) = planned(&train, &[&format!("encoder.kind={kind}")]).unwrap();
        let schedule = of(&findings, "schedule");
        assert_eq!(schedule.reason.contains("encoder.level_bias"), levels, "{kind}: {}", schedule.reason);
        assert_eq!(config.encoder.level_bias != 0.0, levels, "{kind}");
    }
}

#[test]
fn a_small_object_needs_a_small_box_and_given_texels_steps_and_cells_stay_as_wide() {
    let before = Config::default();
    let (config, findings) =
        planned(&views(true), &["encoder.levels=5", "plan.detail=off", "plan.schedule=off"]).unwrap();
    for decision in ["aabb", "occupancy", "file"] {
        assert!(of(&findings, decision).left_out, "{findings:?}");
    }
    let aabb = Aabb::<f64>::new(&config.scene);
    for (axis, centre) in [0.5, 0.0, 0.0].into_iter().enumerate() {
        assert!(aabb.min[axis] <= centre - 0.39 && aabb.min[axis] > centre - 0.6, "{aabb:?}");
        assert!(aabb.max[axis] >= centre + 0.39 && aabb.max[axis] < centre + 0.6, "{aabb:?}");
    }
    let texel = aabb.longest() / f64::from(config.encoder.plane_size);
    assert!((0.8..=1.002).contains(&(texel / (3.0 / 512.0))), "{texel}");
    let step = f64::from(config.step_length() / before.step_length());
    assert!((0.98..1.0001).contains(&step), "{step}");
    let cell = aabb.extent().iter().product::<f64>().cbrt() / f64::from(config.occupancy.resolution);
    assert!((0.75..=1.0).contains(&(cell / (3.0 / 128.0))), "{cell}");
    assert_eq!(config.file.planes, FilePrecision::F16);
}

/// Checks that box, texels and steps follow if the same scene is given in other units and at another place.
#[test]
fn the_box_and_its_detail_do_not_depend_on_units_or_place() {
    let near = views(true);
    let (scale, shift) = (250.0, DVec3::new(-3000.0, 500.0, 40.0));
    let mut far = near.clone();
    for view in &mut far.views {
        view.camera.origin = scale * view.camera.origin + shift;
    }
    let [(one, _), (other, findings)] = [&near, &far].map(|train| planned(train, &[]).unwrap());
    let [small, large] = [&one, &other].map(|config| Aabb::<f64>::new(&config.scene));
    for axis in 0..3 {
        let moved = scale * small.min[axis] + shift[axis];
        // Boxes are rounded to a hundredth of their size.
        assert!((large.min[axis] - moved).abs() < 0.03 * large.longest(), "{large:?} {findings:?}");
    }
    let alike = |a: u32, b: u32| (0.9..1.12).contains(&(f64::from(a) / f64::from(b)));
    assert!(alike(one.encoder.plane_size, other.encoder.plane_size), "{findings:?}");
    assert!(alike(one.renderer.steps_per_diagonal, other.renderer.steps_per_diagonal), "{findings:?}");
    assert!(warnings_of(&other, &far).is_empty());
}

fn warnings_of(config: &Config, train: &ViewSet) -> Vec<String> {
    let compute = Compute::one_thread();
    warnings(
        config,
        &Facts { train, test: &[], stated: None, origin: LocalOrigin::default(), compute: &compute },
    )
}

#[test]
fn a_box_beside_the_subject_is_told() {
    let train = views(true);
    let beside = ["scene.aabb_min=[5.0, 5.0, 5.0]", "scene.aabb_max=[6.0, 6.0, 6.0]", "plan.aabb=off"];
    let (config, _) = planned(&train, &beside).unwrap();
    let told = warnings_of(&config, &train);
    assert!(told.iter().any(|text| text.contains("covers only 0 %")), "{told:?}");
}

#[test]
fn photographs_say_whether_models_are_solids_and_what_is_behind_them() {
    let (config, _) = planned(&views(true), &[]).unwrap();
    assert_eq!((config.loss.opacity, config.data.background), (0.1, [1.0; 3]));
    let bounded = "scene.contraction=none";
    let (config, findings) = planned(&views(false), &[bounded]).unwrap();
    assert_eq!((config.loss.opacity, config.data.background), (0.0, [1.0, 0.0, 0.0]), "{findings:?}");
    // Rays of contracted space end somewhere: their opacity is known without alpha.
    let (config, findings) = planned(&views(false), &[]).unwrap();
    assert_eq!((config.loss.opacity, config.data.background), (0.1, [1.0, 0.0, 0.0]), "{findings:?}");
    let (config, _) = planned(&views(false), &["loss.opacity=0.3"]).unwrap();
    assert_eq!(config.loss.opacity, 0.3, "what is given stays");
    let error = planned(&views(false), &["loss.opacity=0.1", bounded]).unwrap_err();
    assert!(error.kind() == crate::ErrorKind::Input && error.message().contains("no alpha"), "{error}");
    let (config, _) = planned(&views(true), &["loss.opacity=0.0"]).unwrap();
    assert_eq!(config.loss.opacity, 0.0, "what is given stays");
}

#[test]
fn density_follows_the_size_of_the_box() {
    let of = |side: f64, set: &[&str]| {
        let corners = [-0.5 * side, 0.5 * side].map(|x| format!("[{x}, {x}, {x}]"));
        let given = [format!("scene.aabb_min={}", corners[0]), format!("scene.aabb_max={}", corners[1])];
        let set: Vec<&str> = given.iter().map(String::as_str).chain(set.iter().copied()).collect();
        planned(&views(true), &set).unwrap().0.field.density_scale
    };
    for (side, scale) in
        [(3.0, 1.0), (2.2, 1.0), (4.1, 1.0), (6.0, 0.5), (3072.0, 1.0 / 1024.0), (3e-3, 1024.0)]
    {
        assert_eq!(of(side, &[]), scale, "{side}");
    }
    let (place, _) = planned(&views(false), &[]).unwrap();
    let product = f64::from(place.field.density_scale) * Aabb::<f64>::new(&place.scene).longest();
    assert!((product / 20.0 - 1.0).abs() < 0.005, "{place:?}");
    assert_eq!(of(3000.0, &["field.density_scale=7"]), 7.0, "what is given stays");
    assert_eq!(of(3000.0, &["plan.density=off"]), 1.0);
}

#[test]
fn a_plain_background_bounds_the_scene() {
    let mut plain = views(true);
    for pixel in &mut *plain.pixels {
        if pixel[3] < 255 {
            *pixel = [200, 210, 220, 255];
        }
    }
    let (config, findings) = planned(&plain, &[]).unwrap();
    assert_eq!(config.scene.contraction, Contraction::None, "{findings:?}");
    assert_eq!(config.data.background, [0.784, 0.824, 0.863], "{findings:?}");
    assert_ne!(config.scene, Config::default().scene, "{findings:?}");
}

#[test]
fn a_stray_camera_moves_no_box() {
    for alpha in [true, false] {
        let (usual, _) = planned(&views(alpha), &[]).unwrap();
        let mut moved = views(alpha);
        let scales: Vec<usize> = moved.scales.iter().map(|scale| scale.views.start).collect();
        for first in scales {
            moved.views[first].camera.origin *= 2000.0;
        }
        let (config, findings) = planned(&moved, &[]).unwrap();
        let side = |config: &Config| Aabb::<f64>::new(&config.scene).longest();
        assert!((side(&config) / side(&usual) - 1.0).abs() < 0.2, "{alpha}: {findings:?}");
    }
}

#[test]
fn silhouettes_shrink_the_cube_that_exporters_state() {
    let train = views(true);
    let compute = Compute::one_thread();
    let plan = |stated: Option<&StatedBox>| {
        let mut settings = Settings::defaults();
        make(
            &mut settings,
            &Facts { train: &train, test: &[], stated, origin: LocalOrigin::default(), compute: &compute },
        )
        .unwrap();
        Config::from_settings(&settings).unwrap().scene
    };
    let cube = |half: f64| Aabb { min: [-half; 3], max: [half; 3] };
    let stated = |around_points| StatedBox { aabb: cube(24.0), source: "stated".into(), around_points };
    assert_eq!(plan(Some(&stated(false))), plan(None));
    assert_ne!(plan(Some(&stated(true))), plan(None));
}

#[test]
fn cameras_at_one_place_are_refused() {
    let mut train = views(false);
    let origin = train.views[0].camera.origin;
    train.views.iter_mut().for_each(|view| view.camera.origin = origin);
    let error = planned(&train, &[]).unwrap_err();
    assert!(
        error.kind() == crate::ErrorKind::Input && error.message().contains("stand at one place"),
        "{error}"
    );
    assert!(error.message().contains("world-to-camera"), "{error}");
}

#[test]
fn cameras_at_one_place_but_for_rounding_are_refused() {
    // These are the translations of world-to-camera matrices of cameras on a circle; such cameras get a local origin.
    let mut train = views(false);
    let stated: Vec<Camera> = (train.views.iter().enumerate())
        .map(|(i, view)| Camera { origin: DVec3::new(4e-16 * i as f64, 0.0, -2.5), ..view.camera })
        .collect();
    let origin = LocalOrigin::chosen(&stated);
    assert!(!origin.is_zero());
    train.views.iter_mut().zip(&stated).for_each(|(view, camera)| {
        view.camera.origin = origin.local(camera.origin);
    });
    let compute = Compute::one_thread();
    let cube = StatedBox {
        aabb: Aabb { min: [-24.0; 3], max: [24.0; 3] },
        source: "stated".into(),
        around_points: false,
    };
    for stated in [None, Some(&cube)] {
        let facts = Facts { train: &train, test: &[], stated, origin, compute: &compute };
        let error = make(&mut Settings::defaults(), &facts).unwrap_err();
        assert!(
            error.kind() == crate::ErrorKind::Input && error.message().contains("stand at one place"),
            "{error}"
        );
    }
}

#[test]
fn places_begin_at_known_points_and_rays_end_there_until_half_of_the_run() {
    let known = KnownDepth { pixel: 3, distance: 2.0, deviation: 0.1 };
    let of = |alpha: bool, depths: &[KnownDepth], set: &[&str]| {
        let views = ViewSet { depths: depths.to_vec(), ..views(alpha) };
        planned(&views, set)
            .map(|(config, _)| (config.loss.depth, config.occupancy.seeded, config.occupancy.cleared))
    };
    let (depth, seeded, cleared) = of(false, &[known], &[]).unwrap();
    assert!(seeded > 0.0 && seeded <= 0.5 && cleared > seeded);
    assert!(depth.at(0.0) > 0.0 && depth.values().is_sorted_by(|a, b| a > b) && depth.at(0.5) == 0.0);
    let given = of(false, &[known], &["loss.depth=0.3"]).unwrap();
    assert_eq!((given.0.at(0.9), given.1, given.2), (0.3, 0.0, 0.0), "what is given stays");
    let given = of(false, &[known], &["occupancy.seeded=0.1"]).unwrap();
    assert_eq!(given, (depth, 0.1, cleared), "what is given stays");
    let none = (Config::default().loss.depth, 0.0, 0.0);
    for (alpha, depths, set) in [
        (true, &[known][..], &[][..]),
        (false, &[], &[]),
        (false, &[known], &["scene.contraction=none"]),
        (false, &[known], &["plan.depth=off"]),
    ] {
        assert_eq!(of(alpha, depths, set).unwrap(), none, "{set:?}");
    }
    for set in ["loss.depth=0.1", "occupancy.seeded=0.1", "occupancy.cleared=1", "plan.depth=on"] {
        let error = of(false, &[], &[set]).unwrap_err();
        assert!(error.kind() == crate::ErrorKind::Input && error.message().contains("no points"), "{error}");
    }
}

#[test]
fn places_have_a_hash_grid_unless_an_encoder_is_given() {
    let of = |alpha: bool, set: &[&str]| planned(&views(alpha), set).unwrap();
    let (config, findings) = of(false, &[]);
    assert_eq!(config.encoder.kind, EncoderKind::HashGrid, "{findings:?}");
    let grid = &config.hash_grid;
    assert_eq!((grid.levels, grid.features, grid.downweight), (8, 4, true));
    let changes = || findings.iter().flat_map(|finding| &finding.changes);
    assert!(changes().all(|change| !change.path.starts_with("encoder.") || change.path == "encoder.kind"));
    let (config, _) = of(false, &["plan.encoder=on", "encoder.kind=hash-grid", "hash_grid.levels=12"]);
    assert_eq!((config.hash_grid.levels, config.hash_grid.features), (12, 4), "what is given stays");
    let set = ["hash_grid.log2_entries=21"];
    let (config, _) = of(false, &set);
    assert_eq!((config.encoder.kind, config.hash_grid.log2_entries), (EncoderKind::HashGrid, 21));
    for (alpha, also) in
        [(true, &[][..]), (false, &["plan.encoder=off"]), (false, &["encoder.plane_size=256"])]
    {
        let error = planned(&views(alpha), &[&set, also].concat()).unwrap_err();
        assert!(
            error.kind() == crate::ErrorKind::Input
                && error.message().contains("encoder.kind = \"hash-grid\""),
            "{error}"
        );
    }
    for (alpha, set) in [
        (true, &[][..]),
        (false, &["scene.contraction=none"]),
        (false, &["plan.encoder=off"]),
        (false, &["encoder.kind=tri-mip"]),
        (false, &["plan.encoder=on", "encoder.kind=tri-mip"]),
        (false, &["encoder.plane_size=256"]),
    ] {
        let (config, findings) = of(alpha, set);
        assert_eq!(config.encoder.kind, EncoderKind::TriMip, "{set:?} {findings:?}");
        assert_eq!(config.occupancy.fraction, Config::default().occupancy.fraction, "{set:?}");
    }
    let few = planned(&views_of(false, 15), &[]).unwrap().0;
    assert_eq!((few.encoder.kind, few.loss.opacity), (EncoderKind::TriMip, 0.0), "few pixels");
    assert_eq!(of(false, &[]).0.loss.opacity, 0.1);
    // Many photographs or many samples fill a large table.
    for (count, steps, entries) in
        [(16, 2_000, 17), (16, 200_000, 19), (100, 1_000, 17), (100, 2_000, 19), (100, 70_000, 20)]
    {
        let set = ["train.samples_per_step=65536", &format!("train.steps={steps}")];
        let config = planned(&views_of(false, count), &set).unwrap().0;
        assert_eq!(config.hash_grid.log2_entries, entries, "{count} photographs, {steps} steps");
        assert_eq!(config.renderer.step_scale.at(1.0), 0.5);
    }
    let (bounded, _) = of(true, &["train.samples_per_step=65536", "train.steps=2000"]);
    assert_eq!(bounded.renderer.step_scale.at(1.0), 1.0);
}

/// Checks that a resumed run adopts the decisions of its start from their record.
#[test]
fn decisions_on_the_encoder_are_adopted() {
    let train = views(false);
    let (config, findings) = planned(&train, &[]).unwrap();
    let mut settings = Settings::defaults();
    adopt(&mut settings, &findings).unwrap();
    assert_eq!(Config::from_settings(&settings).unwrap(), config);
}

#[test]
fn what_masks_ignore_is_neither_empty_nor_of_any_colour() {
    let ignored = ViewSet { alpha: Alpha::Kept, ..views(true) };
    let (config, findings) = planned(&ignored, &["scene.contraction=none"]).unwrap();
    // Kept pixels are red, and so are the ignored ones.
    assert_eq!((config.loss.opacity, config.data.background), (0.0, [1.0, 0.0, 0.0]), "{findings:?}");
    assert!(!config.occupancy.hull && config.data.edge_exponents.is_empty());
    let garbage = |colour: [u8; 3]| {
        let mut views = ignored.clone();
        for pixel in views.pixels.iter_mut().filter(|pixel| pixel[3] == 0) {
            pixel[..3].copy_from_slice(&colour);
        }
        planned(&views, &[]).unwrap().0
    };
    assert_eq!(garbage([255; 3]), garbage([0, 40, 80]));
    let error = planned(&ignored, &["loss.opacity=0.1", "scene.contraction=none"]).unwrap_err();
    assert!(error.kind() == crate::ErrorKind::Input && error.message().contains("no alpha"), "{error}");
}

#[test]
fn texels_that_are_given_stay_given_when_the_box_shrinks() {
    let (config, findings) = planned(&views(true), &["encoder.plane_size=16", "encoder.levels=3"]).unwrap();
    assert!(config.encoder.plane_size <= 16 && of(&findings, "aabb").left_out, "{findings:?}");
    let changed = |f: &Finding| f.changes.iter().any(|change| change.path == "encoder.plane_size");
    assert!(!changed(of(&findings, "detail")), "{findings:?}");
}

#[test]
fn networks_and_steps_follow_the_budget() {
    let of = |set: &[&str]| planned(&views(true), set).unwrap().0;
    let hidden = |seconds: &str| of(&[seconds]).field.hidden;
    assert_eq!(["train.seconds=60", "train.seconds=1000", "train.seconds=10000"].map(hidden), [32, 64, 128]);
    assert_eq!(of(&["train.seconds=1000", "field.hidden=96"]).field.hidden, 96, "what is given stays");
    let steps = of(&["train.steps=100", "train.samples_per_step=4096"]);
    assert_eq!((steps.train.samples_per_step, steps.field.hidden), (4096, 32));
    let small = of(&["train.seconds=1"]).train.samples_per_step;
    assert!((4096..16_384).contains(&small), "{small}");
    assert_eq!(of(&["train.seconds=300"]).train.samples_per_step, 16_384, "an object");
    // A long run takes large steps, unless it draws the few pixels of an object often.
    let long = ["train.seconds=10000"];
    let steps = |config: &Config| (config.train.samples_per_step, config.train.batch_scale.at(0.0));
    assert_eq!(steps(&of(&long)), (16_384, 1.0));
    let mut many = views(true);
    let pixels = many.pixels.iter().copied().chain(std::iter::repeat_n([0; 4], 1 << 24));
    many.pixels = pixels.collect::<Vec<_>>().into();
    assert_eq!(steps(&planned(&many, &long).unwrap().0), (65_536, 0.5));
}

#[test]
fn no_sphere_of_any_camera_reaches_a_level_that_is_left_out() {
    let train = views(true);
    for set in [
        &["plan.detail=off"][..],
        &[],
        &["plan.aabb=off", "plan.detail=off"],
        &["encoder.plane_size=4096", "encoder.levels=9", "plan.levels=on"],
    ] {
        let (config, _) = planned(&train, set).unwrap();
        let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
        let [least, most] =
            radii::range(train.views.iter().map(|v| &v.camera), &Aabb::new(&config.scene)).unwrap();
        for plane in 0..3 {
            let top = most.log2() - pyramid.log2_base_radius[plane];
            assert!(top <= (pyramid.levels - 1) as f64, "{set:?}: level {top} of {}", pyramid.levels);
            assert!(pyramid.levels < 8, "{set:?}");
            // Although fine levels are left out, spheres still lie near the base level or below it.
            assert!(least.log2() - pyramid.log2_base_radius[plane] < 1.5, "{set:?}");
        }
    }
}

#[test]
fn what_the_user_set_and_what_cannot_be_known_stays() {
    let (config, findings) = planned(&views(true), &["scene.aabb_min=[-1.0, -1.0, -1.0]"]).unwrap();
    assert!(!findings[0].left_out && findings[0].reason.contains("command line"), "{findings:?}");
    assert_eq!(config.scene.aabb_max, [1.5; 3]);
    let (config, findings) = planned(&views(false), &["scene.contraction=none"]).unwrap();
    assert!(findings[0].reason.contains("no silhouettes"), "{findings:?}");
    let aabb = Aabb::<f64>::new(&config.scene);
    assert!(aabb.min[0] < -4.0 && aabb.max[0] > 4.0, "the surroundings are in it: {aabb:?}");
    let given = ["scene.aabb_max=[1.0, 1.0, 1.0]", "plan.aabb=on"];
    let error = planned(&views(false), &given).unwrap_err();
    assert!(error.message().contains("plan.aabb") && error.kind() == crate::ErrorKind::Input, "{error}");
    let off: Vec<String> = keys().map(|key| format!("plan.{key}=off")).collect();
    let off: Vec<&str> = off.iter().map(String::as_str).collect();
    let (config, findings) = planned(&views(true), &off).unwrap();
    assert!(findings.iter().all(|finding| finding.changes.is_empty()));
    assert_eq!(Config { plan: Config::default().plan, ..config }, Config::default());
}

/// Checks that photographs that show their surroundings get a cube of contracted space with the cameras in its middle,
/// whatever box the data state, and that photographs with alpha, a given box or a contraction of "none" keep space bounded.
#[test]
fn surroundings_are_contracted() {
    let train = views(false);
    let (config, findings) = planned(&train, &[]).unwrap();
    assert_eq!(config.scene.contraction, Contraction::Ball, "{findings:?}");
    config.validate().unwrap();
    let (ball, cameras) = (config.scene.subject(), train.views.iter().map(|view| view.camera.origin));
    let (centre, radius) = (ball.centre()[0], 0.5 * ball.longest());
    let mut distances: Vec<f64> = cameras.map(|origin| (origin - DVec3::splat(centre)).length()).collect();
    distances.sort_by(f64::total_cmp);
    assert!((distances[distances.len() / 2] / radius - 1.0).abs() < 1e-3, "{radius}: {distances:?}");
    let compute = Compute::one_thread();
    let facts =
        Facts { train: &train, test: &[], stated: None, origin: LocalOrigin::default(), compute: &compute };
    assert!(warnings(&config, &facts).iter().all(|warning| !warning.contains("covers only")));
    for (alpha, given) in [
        (true, &[][..]),
        (false, &["scene.contraction=none"]),
        (false, &["scene.aabb_max=[1.0, 1.0, 1.0]"]),
        (false, &["plan.aabb=off"]),
    ] {
        let (config, _) = planned(&views(alpha), given).unwrap();
        assert_eq!(config.scene.contraction, Contraction::None, "{given:?}");
    }
}

/// Checks that no decision of the plan contradicts the settings that the user gives.
#[test]
fn a_given_contraction_of_photographs_with_alpha_is_planned() {
    let (config, findings) = planned(&views(true), &["scene.contraction=ball"]).unwrap();
    assert_eq!(config.scene.contraction, Contraction::Ball, "{findings:?}");
    assert!(!config.occupancy.hull, "{findings:?}");
    config.validate().unwrap();
}

#[test]
fn a_saving_is_told_where_there_is_one() {
    assert_eq!(leave_out::saved("planes", 10_000_000, 20_000_000), "; planes of 40.0 MB instead of 80.0 MB");
    // Two sizes with the same text, two equal sizes, and a size that grows.
    for (after, before) in [(16_775_000, 16_777_216), (5, 5), (20_000_000, 10_000_000)] {
        assert_eq!(leave_out::saved("planes", after, before), "");
    }
    for set in [&[][..], &["encoder.plane_size=16", "encoder.levels=3"]] {
        for finding in planned(&views(true), set).unwrap().1 {
            if let Some((before, after)) = finding.reason.split_once(" instead of ") {
                assert!(!before.ends_with(after), "{}", finding.reason);
            }
        }
    }
}

#[test]
fn directions_go_when_asked() {
    let (config, findings) = planned(&views(true), &["plan.directions=on"]).unwrap();
    assert!(!config.field.directions && of(&findings, "directions").left_out, "{findings:?}");
    assert_eq!(crate::field::params::color_layers(&config)[0][0], 15);
}

#[test]
fn a_run_goes_on_with_the_plan_it_began_with() {
    let (began, findings) = planned(&views(true), &["encoder.plane_size=256"]).unwrap();
    let again = |set: &[&str]| {
        let mut settings = Settings::defaults();
        set.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
        adopt(&mut settings, &findings).unwrap();
        Config::from_settings(&settings).unwrap()
    };
    assert_eq!(again(&["encoder.plane_size=256"]), began);
    // Other settings, or a decision that is switched off, make another run.
    assert!(!again(&["encoder.plane_size=512"]).differences(&began).is_empty());
    assert!(!again(&["encoder.plane_size=256", "plan.aabb=off"]).differences(&began).is_empty());
}
