// Writes the known depths of a training step's pixels to their targets. Needs `drawn`.

@group(0) @binding(5) var<storage, read_write> targets: array<f32>;
// Known depths, sorted by pixel.
@group(0) @binding(9) var<storage, read> depths: array<KnownDepth>;

@compute @workgroup_size(GROUP)
fn known_depths(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let pixel = drawn(params.first + i).pixel;
    // Finds the first entry that is not before the pixel.
    var low = 0u;
    var high = params.depths;
    while low < high {
        let middle = (low + high) / 2u;
        if depths[middle].pixel < pixel {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    if low < params.depths && depths[low].pixel == pixel {
        targets[TARGET_FLOATS * i + TARGET_DISTANCE] = depths[low].distance;
        targets[TARGET_FLOATS * i + TARGET_DEVIATION] = depths[low].deviation;
    }
}
