// C[rows, N] = A[rows, K] · W[K, N]. A workgroup computes ROWS rows by 16·TN columns, and an invocation computes 4 rows
// by TN columns. `finish` determines what is stored.

@group(0) @binding(0) var<storage, read> left: array<f32>;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> product: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

const DEPTH: u32 = 16u;
const COLUMNS: u32 = 16u * TN;

var<workgroup> left_tile: array<f32, ROWS * DEPTH>;
var<workgroup> weight_tile: array<f32, DEPTH * COLUMNS>;

@compute @workgroup_size(THREADS)
fn multiply(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let rows = counts[params.counter];
    let tile = group.y * groups.x + group.x;
    let first_row = tile / (N / COLUMNS) * ROWS;
    let first_column = tile % (N / COLUMNS) * COLUMNS;
    // The condition is uniform over the workgroup.
    if first_row >= rows {
        return;
    }
    let row = local / 16u;
    let column = local % 16u;
    var sums: array<array<f32, TN>, 4>;
    for (var depth = 0u; depth < K; depth += DEPTH) {
        for (var i = local; i < ROWS * DEPTH; i += THREADS) {
            let r = first_row + i / DEPTH;
            var value = 0.0;
            if r < rows {
                value = left[r * K + depth + i % DEPTH];
            }
            left_tile[(i % DEPTH) * ROWS + i / DEPTH] = value;
        }
        for (var i = local; i < DEPTH * COLUMNS; i += THREADS) {
            weight_tile[i] = weights[(depth + i / COLUMNS) * N + first_column + i % COLUMNS];
        }
        workgroupBarrier();
        for (var p = 0u; p < DEPTH; p++) {
            var w: array<f32, TN>;
            for (var j = 0u; j < TN; j++) {
                w[j] = weight_tile[p * COLUMNS + 16u * j + column];
            }
            for (var i = 0u; i < 4u; i++) {
                let a = left_tile[p * ROWS + 4u * row + i];
                for (var j = 0u; j < TN; j++) {
                    sums[i][j] += a * w[j];
                }
            }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < 4u; i++) {
        let r = first_row + 4u * row + i;
        if r >= rows {
            break;
        }
        for (var j = 0u; j < TN; j++) {
            let at = r * N + first_column + 16u * j + column;
            product[at] = finish(sums[i][j], at);
        }
    }
}
