// C[rows, N] = A[rows, K] · W[K, N] with cooperative matrices. A workgroup computes ROWS rows; each of its subgroups
// computes strips of T rows by T·TN columns. A is multiplied by SCALE so that small gradients do not underflow in f16.
// `finish` determines what is stored. Arrays are padded to whole blocks of rows; values after the last row are
// overwritten and never read.

@group(0) @binding(0) var<storage, read> left: array<f32>;
@group(0) @binding(1) var<storage, read> weights: array<f16>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> product: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
// Number of factors that f16 cannot hold.
@group(0) @binding(6) var<storage, read_write> overflows: array<atomic<u32>>;

const STRIPS: u32 = N / (T * TN);

var<workgroup> block: array<f16, ROWS * K>;

@compute @workgroup_size(COOPERATING)
fn multiply(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroups: u32,
) {
    let rows = counts[params.counter];
    let first = (group.y * groups.x + group.x) * ROWS;
    // The condition is uniform over the workgroup.
    if first >= rows {
        return;
    }
    var lost = 0u;
    for (var i = local; i < ROWS * K; i += COOPERATING) {
        var value = 0.0;
        if first + i / K < rows {
            value = f32(SCALE) * left[first * K + i];
        }
        lost += too_large(value);
        block[i] = half(value);
    }
    if lost > 0u {
        atomicAdd(&overflows[0], lost);
    }
    workgroupBarrier();
    for (var strip = subgroup; strip < ROWS / T * STRIPS; strip += subgroups) {
        let row = strip / STRIPS * T;
        let column = strip % STRIPS * T * TN;
        var sums: array<Sums, TN>;
        for (var k = 0u; k < K; k += T) {
            let a = coopLoadT<Left>(&block[row * K + k], K);
            for (var j = 0u; j < TN; j++) {
                let b = coopLoadT<Right>(&weights[k * N + column + j * T], N);
                sums[j] = coopMultiplyAdd(a, b, sums[j]);
            }
        }
        for (var j = 0u; j < TN; j++) {
            coopStoreT(sums[j], &product[(first + row) * N + column + j * T], N);
        }
    }
    storageBarrier();
    for (var i = local; i < ROWS * N; i += COOPERATING) {
        let at = first * N + i;
        if first + i / N < rows {
            product[at] = finish(product[at] / f32(SCALE), at);
        }
    }
}
