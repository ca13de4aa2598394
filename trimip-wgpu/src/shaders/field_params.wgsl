// Parameters of the kernels before and after the two networks.
@group(0) @binding(2) var<uniform> params: Params;
