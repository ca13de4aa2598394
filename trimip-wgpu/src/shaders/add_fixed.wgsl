// Adds to gradients in fixed point. The high word of a sum is written only if it changes. Values that do not fit are
// left out and counted.
@group(0) @binding(3) var<storage, read_write> base: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> derived: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> base_high: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> derived_high: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> skipped: array<atomic<u32>>;

fn add_base(at: u32, value: f32) {
    if !fits(value) {
        atomicAdd(&skipped[0], 1u);
        return;
    }
    let words = to_fixed(value);
    let before = atomicAdd(&base[at], words.x);
    let high = words.y + select(0u, 1u, before + words.x < before);
    if high != 0u {
        atomicAdd(&base_high[at], high);
    }
}

fn add_derived(at: u32, value: f32) {
    if !fits(value) {
        atomicAdd(&skipped[0], 1u);
        return;
    }
    let words = to_fixed(value);
    let before = atomicAdd(&derived[at], words.x);
    let high = words.y + select(0u, 1u, before + words.x < before);
    if high != 0u {
        atomicAdd(&derived_high[at], high);
    }
}
