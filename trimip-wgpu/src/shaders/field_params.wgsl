// Parameters of the kernels between the two networks.
struct Params {
    counter: u32,
    // Width of the colour network's input: the view, the geometry features with their sines and cosines, zeros.
    width: u32,
    view: u32,
    geometry: u32,
    // Width of the density network's output: a logit, geometry features, zeros.
    outputs: u32,
    // 1 if the view is coordinates with sines and cosines, 0 if it is spherical harmonics.
    frequencies_of_view: u32,
    // Numbers of frequencies.
    view_frequencies: u32,
    geometry_frequencies: u32,
    // Function of the density, its shift and its factor.
    density: u32,
    shift: f32,
    scale: f32,
    // 1 without networks: the outputs are logits of density and of colours.
    direct: u32,
}

@group(0) @binding(2) var<uniform> params: Params;
