// Parameters of the kernels between the two networks.
@group(0) @binding(2) var<uniform> params: Params;
