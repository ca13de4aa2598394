//! The decisions of the scene plan, in their order.

use super::decision::Decision;
use super::{aabb, cones, crop, depth, detail, hash_grid, leave_out, recipe, tri_mip};

/// All decisions, in order: each sees the changes of the earlier ones.
pub(super) const DECISIONS: [Decision; 20] = [
    Decision {
        key: "aabb",
        owns: &["scene.aabb_min", "scene.aabb_max", "encoder.shape"],
        choice: |config| config.plan.aabb,
        decide: aabb::find,
    },
    Decision {
        key: "encoder",
        owns: &["encoder.kind"],
        choice: |config| config.plan.encoder,
        decide: hash_grid::for_places,
    },
    Decision {
        key: "background",
        owns: &["data.background"],
        choice: |config| config.plan.background,
        decide: recipe::background,
    },
    Decision {
        key: "edges",
        owns: &["data.edge_exponents"],
        choice: |config| config.plan.edges,
        decide: recipe::edges,
    },
    Decision {
        key: "hull",
        owns: &["occupancy.hull"],
        choice: |config| config.plan.hull,
        decide: recipe::hull,
    },
    Decision {
        key: "solids",
        owns: &["loss.opacity", "train.background"],
        choice: |config| config.plan.solids,
        decide: recipe::solids,
    },
    Decision {
        key: "direction_delay",
        owns: &["field.direction_delay"],
        choice: |config| config.plan.direction_delay,
        decide: recipe::direction_delay,
    },
    Decision { key: "surfaces", owns: &[], choice: |config| config.plan.surfaces, decide: recipe::surfaces },
    Decision {
        key: "density",
        owns: &["field.density_scale"],
        choice: |config| config.plan.density,
        decide: recipe::density,
    },
    Decision {
        key: "error_map",
        owns: &["train.error_map"],
        choice: |config| config.plan.error_map,
        decide: recipe::error_map,
    },
    Decision {
        key: "coarse_to_fine",
        owns: &["train.finest_scale"],
        choice: |config| config.plan.coarse_to_fine,
        decide: recipe::coarse_to_fine,
    },
    Decision {
        key: "depth",
        owns: &["loss.depth"],
        choice: |config| config.plan.depth,
        decide: depth::decide,
    },
    Decision { key: "crop", owns: &["scene.crop"], choice: |config| config.plan.crop, decide: crop::decide },
    Decision { key: "schedule", owns: &[], choice: |config| config.plan.schedule, decide: recipe::schedule },
    Decision { key: "detail", owns: &[], choice: |config| config.plan.detail, decide: detail::decide },
    Decision {
        key: "cones",
        owns: &["renderer.cones", "renderer.cone_width"],
        choice: |config| config.plan.cones,
        decide: cones::decide,
    },
    Decision {
        key: "levels",
        owns: &["encoder.levels"],
        choice: |config| config.plan.levels,
        decide: tri_mip::levels,
    },
    Decision {
        key: "occupancy",
        owns: &[],
        choice: |config| config.plan.occupancy,
        decide: leave_out::occupancy,
    },
    Decision {
        key: "directions",
        owns: &["field.directions"],
        choice: |config| config.plan.directions,
        decide: leave_out::directions,
    },
    Decision {
        key: "file",
        owns: &["file.planes"],
        choice: |config| config.plan.file,
        decide: leave_out::half_precision,
    },
];
