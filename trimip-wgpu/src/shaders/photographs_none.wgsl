// No pixel stores the number of its photograph.

fn keep_photograph(i: u32, view: u32) {}
