// Adds to gradients with the device's f32 atomics, in any order.
@group(0) @binding(3) var<storage, read_write> base: array<atomic<f32>>;
@group(0) @binding(4) var<storage, read_write> derived: array<atomic<f32>>;

fn add_base(at: u32, value: f32) {
    atomicAdd(&base[at], value);
}

fn add_derived(at: u32, value: f32) {
    atomicAdd(&derived[at], value);
}
