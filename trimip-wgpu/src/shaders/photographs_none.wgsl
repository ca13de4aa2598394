// Photographs of one exposure: no pixel needs to know its photograph.

fn keep_photograph(i: u32, view: u32) {}
