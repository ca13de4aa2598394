// Location of a cell's bit: blocks of SIDE cells along each side, two words per block.

struct Bit {
    word: u32,
    bit: u32,
}

// Returns the bit of an item, a cell or a block, in a grid of `blocks` blocks along each side.
fn bit_of(item: vec3<u32>, blocks: u32) -> Bit {
    let block = item / SIDE;
    let within = item % SIDE;
    let bit = within.x + SIDE * (within.y + SIDE * within.z);
    let word = 2u * (block.x + blocks * (block.y + blocks * block.z));
    return Bit(word + bit / 32u, bit % 32u);
}
