// The part of a segment of samples that fits into arrays of `capacity` samples. A batch larger than its arrays is
// truncated; the counters tell how many samples are dropped.
fn fitting(segment: vec2<u32>, capacity: u32) -> vec2<u32> {
    let start = min(segment.x, capacity);
    return vec2<u32>(start, min(segment.y, capacity - start));
}
