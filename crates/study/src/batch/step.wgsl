// One step of all compartments of all samples of a batch, in the chip's integers (docs/semantics.md, equations 1 to 7a).
// An invocation is one compartment of one sample. Sums wrap at 32 bits and are narrowed to 22 afterwards, which gives the
// same as narrowing the exact sum.

struct Compartment {
    keep_u: i32,
    keep_v: i32,
    bias: i32,
    fires_from: i32,
    vmin: i32,
    vmax: i32,
    refractory: i32,
    // Whether a spike subtracts.
    subtracts: i32,
    taken: i32,
    start_step: u32,
    first_synapse: u32,
    past_synapse: u32,
}

struct Synapse {
    source: u32,
    way: u32,
    adds: i32,
}

@group(0) @binding(1) var<storage, read> compartments: array<Compartment>;
@group(0) @binding(2) var<storage, read> synapses: array<Synapse>;
// u of all, then v of all, then the refractory counters of all.
@group(0) @binding(3) var<storage, read_write> registers: array<i32>;
@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = (group.y * groups.x + group.x) * 64u + local;
    let all = now.compartments * now.samples;
    if (index >= all) {
        return;
    }
    let compartment = index / now.samples;
    let sample = index % now.samples;
    let rule = compartments[compartment];
    if (now.step < rule.start_step) {
        return;
    }

    var sum = 0;
    for (var at = rule.first_synapse; at < rule.past_synapse; at++) {
        let synapse = synapses[at];
        if (arrives(synapse.source, synapse.way, sample)) {
            sum += synapse.adds;
        }
    }

    var u = registers[index];
    var v = registers[all + index];
    var hold = registers[2u * all + index];
    if (returns_to_rest(rule.start_step)) {
        u = 0;
        v = 0;
        hold = 0;
    }
    // Narrowed to 22 and 24 bits, the sign included.
    let q = (sum << 10u) >> 10u;
    u = ((decay(u, rule.keep_u) + q) << 8u) >> 8u;
    let input = ((u + rule.bias) << 8u) >> 8u;
    v = clamp(decay(v, rule.keep_v) + input, rule.vmin, rule.vmax);
    hold = max(hold - 1, 0);
    let spiked = hold == 0 && v >= rule.fires_from;
    if (rule.subtracts == 1) {
        v -= select(0, rule.taken, spiked);
    } else {
        v = select(v, 0, spiked || hold > 0);
        hold = select(hold, rule.refractory, spiked);
    }
    registers[index] = u;
    registers[all + index] = v;
    registers[2u * all + index] = hold;
    if (spiked) {
        send(compartment, sample);
    }
}
