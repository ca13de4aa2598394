// The part of a segment of samples that fits into arrays of `capacity` samples. A batch larger than its arrays is
// truncated; counters record the number of dropped samples.
fn fitting(segment: vec2<u32>, capacity: u32) -> vec2<u32> {
    let start = min(segment.x, capacity);
    return vec2<u32>(start, min(segment.y, capacity - start));
}
