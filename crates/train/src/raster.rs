//! Spikes of one population over one sample, grouped by step.
//!
//! An event has a value: 1 for a spike, any number in the smoothed network of gradient checks.

/// Events of `units` channels or neurons over `steps` timesteps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Raster {
    /// Number of channels or neurons.
    units: usize,
    /// One more than steps; events of step t are `first[t]..first[t + 1]`.
    first: Vec<u32>,
    unit: Vec<u32>,
    value: Vec<f32>,
}

impl Raster {
    /// A raster without steps, to be filled by [`Raster::push`] and [`Raster::end_step`].
    pub fn new(units: usize) -> Self {
        Raster { units, first: vec![0], unit: Vec::new(), value: Vec::new() }
    }

    /// Spikes from (step, unit) pairs; duplicates count once, pairs outside are dropped.
    pub fn from_events(units: usize, steps: usize, mut events: Vec<(u32, u32)>) -> Self {
        events.retain(|&(step, unit)| (step as usize) < steps && (unit as usize) < units);
        events.sort_unstable();
        events.dedup();
        let mut raster = Raster::new(units);
        let mut events = events.into_iter().peekable();
        for step in 0..steps as u32 {
            while let Some((_, unit)) = events.next_if(|event| event.0 == step) {
                raster.push(unit, 1.0);
            }
            raster.end_step();
        }
        raster
    }

    /// Empties it, keeping its memory.
    pub fn clear(&mut self, units: usize) {
        self.units = units;
        self.first.clear();
        self.first.push(0);
        self.unit.clear();
        self.value.clear();
    }

    /// Adds an event to the step that is being filled.
    pub fn push(&mut self, unit: u32, value: f32) {
        self.unit.push(unit);
        self.value.push(value);
    }

    /// Ends the step that is being filled.
    pub fn end_step(&mut self) {
        self.first.push(self.unit.len() as u32);
    }

    /// Number of channels or neurons.
    pub fn units(&self) -> usize {
        self.units
    }

    /// Number of timesteps.
    pub fn steps(&self) -> usize {
        self.first.len() - 1
    }

    /// Number of events.
    pub fn count(&self) -> usize {
        self.unit.len()
    }

    /// (unit, value) of the events of a step, in ascending order of units.
    pub fn at(&self, step: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.first[step] as usize..self.first[step + 1] as usize;
        self.unit[range.clone()].iter().zip(&self.value[range]).map(|(&unit, &value)| (unit as usize, value))
    }

    /// (step, unit) of every event.
    pub fn events(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        (0..self.steps()).flat_map(move |step| self.at(step).map(move |(unit, _)| (step as u32, unit as u32)))
    }

    /// Summed values of each unit.
    pub fn counts(&self) -> Vec<f32> {
        let mut counts = vec![0.0; self.units];
        for (&unit, &value) in self.unit.iter().zip(&self.value) {
            counts[unit as usize] += value;
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_grouped_and_counted_once() {
        let raster = Raster::from_events(3, 4, vec![(2, 1), (0, 2), (2, 0), (2, 1), (4, 0), (1, 3)]);
        assert_eq!((raster.steps(), raster.count(), raster.units()), (4, 3, 3));
        assert_eq!(raster.at(2).collect::<Vec<_>>(), [(0, 1.0), (1, 1.0)]);
        assert_eq!(raster.events().collect::<Vec<_>>(), [(0, 2), (2, 0), (2, 1)]);
        assert_eq!(raster.counts(), [1.0, 1.0, 1.0]);
    }
}
