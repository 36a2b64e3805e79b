// What a step of a batch is told and how spikes lie, whatever neurons are computed in.

struct Step {
    step: u32,
    samples: u32,
    // Words of 32 samples.
    words: u32,
    channels: u32,
    sources: u32,
    compartments: u32,
    // Steps between resets; 0 for none.
    interval: u32,
    offset: u32,
}

@group(0) @binding(0) var<uniform> now: Step;
// A bit a sample: [step][source][word]; channels come before compartments.
@group(0) @binding(4) var<storage, read_write> spikes: array<atomic<u32>>;

// Whether a source's spike of so many steps ago enters this step in a sample.
fn arrives(source: u32, way: u32, sample: u32) -> bool {
    if (way > now.step) {
        return false;
    }
    let carrier = ((now.step - way) * now.sources + source) * now.words + (sample >> 5u);
    return ((atomicLoad(&spikes[carrier]) >> (sample & 31u)) & 1u) == 1u;
}

// Whether what starts in a step returns to rest in this one.
fn returns_to_rest(start_step: u32) -> bool {
    let since = now.step - start_step;
    return now.interval > 0u && since >= now.offset && (since - now.offset) % now.interval == 0u;
}

// Keeps a compartment's spike of this step.
fn send(compartment: u32, sample: u32) {
    let own = (now.step * now.sources + now.channels + compartment) * now.words + (sample >> 5u);
    atomicOr(&spikes[own], 1u << (sample & 31u));
}
