// Decays a list of values: what decay.wgsl gives, to be held against 64 bits.
@group(0) @binding(0) var<storage, read> pairs: array<vec2<i32>>;
@group(0) @binding(1) var<storage, read_write> results: array<i32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = group.x * 64u + local;
    if (index < arrayLength(&pairs)) {
        results[index] = decay(pairs[index].x, pairs[index].y);
    }
}
