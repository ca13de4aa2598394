// Weight gradients with cooperative matrices: partial[chunk] = Aᵀ·D over the rows of a chunk; A has K columns, D has N
// columns. Each subgroup computes T rows by T·TN columns of one chunk. D is multiplied by SCALE so that small gradients
// do not underflow in f16; `reduce` adds the chunks in order and divides by SCALE.

@group(0) @binding(0) var<storage, read> left: array<f32>;
@group(0) @binding(1) var<storage, read> right: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> partial: array<f32>;
@group(0) @binding(4) var<storage, read> counts: array<u32>;
// Number of factors that f16 cannot hold.
@group(0) @binding(6) var<storage, read_write> overflows: array<atomic<u32>>;

const DEPTH: u32 = 32u;
const HEIGHT: u32 = T * SUBGROUPS;
const WIDTH: u32 = T * TN;
const ACROSS: u32 = N / WIDTH;
const DOWN: u32 = (K + HEIGHT - 1u) / HEIGHT;

var<workgroup> left_tile: array<f16, DEPTH * HEIGHT>;
var<workgroup> right_tile: array<f16, DEPTH * WIDTH>;

@compute @workgroup_size(COOPERATING)
fn accumulate(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_id) subgroup: u32,
) {
    let rows = counts[params.counter];
    let chunk = group.x / (DOWN * ACROSS);
    let tile = group.x % (DOWN * ACROSS);
    let first_k = tile / ACROSS * HEIGHT;
    let first_n = tile % ACROSS * WIDTH;
    let per_chunk = (rows + CHUNKS * DEPTH - 1u) / (CHUNKS * DEPTH) * DEPTH;
    let begin = min(chunk * per_chunk, rows);
    let end = min(begin + per_chunk, rows);
    // A subgroup without rows of its own skips the loops over depth and matrices; the condition is subgroup-uniform.
    let works = subgroup < SUBGROUPS && first_k + subgroup * T < K;
    let depth = select(0u, DEPTH, works);
    let across = select(0u, TN, works);
    var lost = 0u;
    var sums: array<Sums, TN>;
    for (var first = begin; first < end; first += DEPTH) {
        for (var i = local; i < DEPTH * HEIGHT; i += COOPERATING) {
            let r = first + i / HEIGHT;
            let k = first_k + i % HEIGHT;
            var value = 0.0;
            if r < end && k < K {
                value = left[r * K + k];
            }
            lost += too_large(value);
            left_tile[i] = half(value);
        }
        for (var i = local; i < DEPTH * WIDTH; i += COOPERATING) {
            let r = first + i / WIDTH;
            var value = 0.0;
            if r < end {
                value = f32(SCALE) * right[r * N + first_n + i % WIDTH];
            }
            lost += too_large(value);
            right_tile[i] = half(value);
        }
        workgroupBarrier();
        for (var p = 0u; p < depth; p += T) {
            // A column-major load gives the transpose.
            let a = coopLoad<Left>(&left_tile[p * HEIGHT + subgroup * T], HEIGHT);
            for (var j = 0u; j < TN; j++) {
                let b = coopLoadT<Right>(&right_tile[p * WIDTH + j * T], WIDTH);
                sums[j] = coopMultiplyAdd(a, b, sums[j]);
            }
        }
        workgroupBarrier();
    }
    if lost > 0u {
        atomicAdd(&overflows[0], lost);
    }
    let at = chunk * K * N + (first_k + subgroup * T) * N + first_n;
    for (var j = 0u; j < across; j++) {
        coopStoreT(sums[j], &partial[at + j * T], N);
    }
}
