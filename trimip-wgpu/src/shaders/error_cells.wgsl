// The cells of the error map.

// Smallest random number that draws each cell, ascending from 0.
@group(0) @binding(10) var<storage, read> starts: array<u32>;

// Returns the cell that a random number draws.
fn cell_of(bits: u32) -> u32 {
    var low = 0u;
    var high = params.cells.x;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if starts[middle] <= bits {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}
