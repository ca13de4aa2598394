// Adds to f32 gradients with a compare-and-exchange of their bits, in any order. Every device supports this operation.
@group(0) @binding(3) var<storage, read_write> base: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> derived: array<atomic<u32>>;

fn add_base(at: u32, value: f32) {
    var old = atomicLoad(&base[at]);
    loop {
        let result = atomicCompareExchangeWeak(&base[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}

fn add_derived(at: u32, value: f32) {
    var old = atomicLoad(&derived[at]);
    loop {
        let result = atomicCompareExchangeWeak(&derived[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}
