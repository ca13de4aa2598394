// Weight gradients: partial[chunk] = Aᵀ·D over the rows of a chunk; A has K columns, D has N columns. A workgroup
// computes a tile of 16·TK by 16·TN of one chunk; `reduce` adds up the chunks in order. No atomics are used, so the
// result is bit-identical in every run.

@group(0) @binding(0) var<storage, read> left: array<f32>;
@group(0) @binding(1) var<storage, read> right: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> partial: array<f32>;
@group(0) @binding(4) var<storage, read> counts: array<u32>;

const DEPTH: u32 = 16u;
const HEIGHT: u32 = 16u * TK;
const WIDTH: u32 = 16u * TN;
const TILES: u32 = (K / HEIGHT) * (N / WIDTH);

var<workgroup> left_tile: array<f32, DEPTH * HEIGHT>;
var<workgroup> right_tile: array<f32, DEPTH * WIDTH>;

@compute @workgroup_size(THREADS)
fn accumulate(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let rows = counts[params.counter];
    let chunk = group.x / TILES;
    let tile = group.x % TILES;
    let first_k = tile / (N / WIDTH) * HEIGHT;
    let first_n = tile % (N / WIDTH) * WIDTH;
    let per_chunk = (rows + CHUNKS * DEPTH - 1u) / (CHUNKS * DEPTH) * DEPTH;
    let begin = min(chunk * per_chunk, rows);
    let end = min(begin + per_chunk, rows);
    let row = local / 16u;
    let column = local % 16u;
    var sums: array<array<f32, TN>, TK>;
    for (var first = begin; first < end; first += DEPTH) {
        for (var i = local; i < DEPTH * HEIGHT; i += THREADS) {
            let r = first + i / HEIGHT;
            var value = 0.0;
            if r < end {
                value = left[r * K + first_k + i % HEIGHT];
            }
            left_tile[i] = value;
        }
        for (var i = local; i < DEPTH * WIDTH; i += THREADS) {
            let r = first + i / WIDTH;
            var value = 0.0;
            if r < end {
                value = right[r * N + first_n + i % WIDTH];
            }
            right_tile[i] = value;
        }
        workgroupBarrier();
        for (var p = 0u; p < DEPTH; p++) {
            for (var i = 0u; i < TK; i++) {
                let a = left_tile[p * HEIGHT + 16u * i + row];
                for (var j = 0u; j < TN; j++) {
                    sums[i][j] += a * right_tile[p * WIDTH + 16u * j + column];
                }
            }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < TK; i++) {
        for (var j = 0u; j < TN; j++) {
            let at = (first_k + 16u * i + row) * N + first_n + 16u * j + column;
            partial[chunk * K * N + at] = sums[i][j];
        }
    }
}
