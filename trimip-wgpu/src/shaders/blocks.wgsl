// Where a cell's bit lies: blocks of SIDE cells along each side, two words a block.

struct Bit {
    word: u32,
    bit: u32,
}

// Bit of an item in blocks of which there are `blocks` along each side.
fn bit_of(item: vec3<u32>, blocks: u32) -> Bit {
    let block = item / SIDE;
    let within = item % SIDE;
    let bit = within.x + SIDE * (within.y + SIDE * within.z);
    let word = 2u * (block.x + blocks * (block.y + blocks * block.z));
    return Bit(word + bit / 32u, bit % 32u);
}
