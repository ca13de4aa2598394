// Each pixel stores the number of its photograph, for exposure gains and camera poses.

@group(0) @binding(7) var<storage, read_write> photographs: array<u32>;
// The photograph of each view.
@group(0) @binding(8) var<storage, read> photograph_of_view: array<u32>;

fn keep_photograph(i: u32, view: u32) {
    photographs[i] = photograph_of_view[view];
}
