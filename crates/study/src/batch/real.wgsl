// One step of all compartments of all samples of a batch in f32: what src/reference computes, spike response neurons by
// recursion and current-based ones (docs/semantics.md, equations 2 to 7 without rounding). An invocation is one compartment of
// one sample. A compiler may join a product and a sum into one rounding, so that last digits differ between devices.

struct Compartment {
    // Whether it is a spike response neuron.
    srm: u32,
    start_step: u32,
    first_synapse: u32,
    past_synapse: u32,
    threshold: f32,
    // Whether a voltage equal to the threshold spikes.
    inclusive: u32,
    // Of a current-based neuron; of a spike response neuron what remains of its response and refractory response.
    keep_u: f32,
    keep_v: f32,
    // Factors of the two responses, or bias and lower limit.
    first: f32,
    second: f32,
    high: f32,
    refractory: u32,
    subtracts: u32,
}

struct Synapse {
    source: u32,
    way: u32,
    adds: f32,
}

@group(0) @binding(1) var<storage, read> compartments: array<Compartment>;
@group(0) @binding(2) var<storage, read> synapses: array<Synapse>;
// Six numbers of all: the potential, then u and the steps for which v is held, or both states of the response, both of the
// refractory response, and whether it spiked in the last step.
@group(0) @binding(3) var<storage, read_write> states: array<f32>;
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

    var sum = 0.0;
    for (var at = rule.first_synapse; at < rule.past_synapse; at++) {
        let synapse = synapses[at];
        if (arrives(synapse.source, synapse.way, sample)) {
            sum += synapse.adds;
        }
    }

    if (returns_to_rest(rule.start_step)) {
        for (var state = 0u; state < 6u; state++) {
            states[state * all + index] = 0.0;
        }
    }
    var spiked = false;
    if (rule.srm == 1u) {
        let response = rule.keep_u * states[all + index] + sum;
        let later = rule.keep_u * states[2u * all + index] + rule.keep_u * response;
        let refractory = rule.keep_v * states[3u * all + index] + states[5u * all + index];
        let refractory_later = rule.keep_v * states[4u * all + index] + rule.keep_v * refractory;
        let potential = rule.first * later + rule.second * refractory_later;
        spiked = potential >= rule.threshold;
        states[index] = potential;
        states[all + index] = response;
        states[2u * all + index] = later;
        states[3u * all + index] = refractory;
        states[4u * all + index] = refractory_later;
        states[5u * all + index] = select(0.0, 1.0, spiked);
    } else {
        let u = rule.keep_u * states[all + index] + sum;
        states[all + index] = u;
        let v = clamp(rule.keep_v * states[index] + (u + rule.first), rule.second, rule.high);
        let held = states[2u * all + index];
        if (held > 0.0) {
            states[2u * all + index] = held - 1.0;
            states[index] = 0.0;
        } else {
            spiked = v > rule.threshold || (rule.inclusive == 1u && v == rule.threshold);
            states[index] = select(v, select(0.0, v - rule.threshold, rule.subtracts == 1u), spiked);
            states[2u * all + index] = select(0.0, f32(rule.refractory - 1u), spiked);
        }
    }
    if (spiked) {
        send(compartment, sample);
    }
}
