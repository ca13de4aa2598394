// Returns the part of a segment of samples that fits into arrays of `capacity` samples. If a batch is larger than its
// arrays, it is truncated, and counters record the number of dropped samples.
fn fitting(segment: vec2<u32>, capacity: u32) -> vec2<u32> {
    let start = min(segment.x, capacity);
    return vec2<u32>(start, min(segment.y, capacity - start));
}
