//! The error ladder as plotted: one bar per step for each of a few measures, those at the instants first.

use super::quantity::{Scale, percent, significant};
use crate::policy::FED_IN_RAD;
use crate::verdict::{HorizonError, Lack, Rung};

/// A measure of the ladder: one value per step.
pub(super) struct Measure {
    /// `force that the model lacks`.
    pub name: String,
    /// The unit that suits its values.
    pub scale: Scale,
    /// Per step: on held-out flight, on the flight of the fit.
    pub values: Vec<[Option<f64>; 2]>,
}

impl Measure {
    fn new(name: String, unit: &str, mut values: Vec<[Option<f64>; 2]>) -> Option<Self> {
        values.iter_mut().flatten().for_each(|v| *v = v.filter(|v| v.is_finite()));
        let most = values.iter().flatten().flatten().fold(0.0f64, |m, v| m.max(*v));
        (most > 0.0).then(|| Self { name, scale: Scale::for_size(most, unit), values })
    }

    /// The plotted value of a step: on held-out flight if there is any.
    pub fn drawn(&self, rung: usize) -> Option<f64> {
        let unseen = self.values.iter().any(|v| v[0].is_some());
        self.values[rung][usize::from(!unseen)]
    }

    /// Length of a bar: the value over the largest of all.
    pub fn length(&self, value: f64) -> f64 {
        let most = self.values.iter().flatten().flatten().fold(0.0f64, |m, v| m.max(*v));
        if most > 0.0 { (value / most).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// `45.1 mN`.
    pub fn words(&self, rung: usize) -> String {
        self.drawn(rung).map_or_else(|| "–".into(), |v| self.scale.show(v, 3))
    }

    /// `11 %`, relative to the first step.
    pub fn share(&self, rung: usize) -> String {
        match (self.drawn(rung), self.drawn(0)) {
            (Some(v), Some(first)) if first > 0.0 => percent(v / first),
            _ => String::new(),
        }
    }
}

/// Whether the attitude is a result of the model, not an input, in any step.
pub fn turns(ladder: &[Rung]) -> bool {
    ladder.iter().flat_map(|r| r.training.iter().chain(&r.held_out)).any(|e| e.attitude_rad > FED_IN_RAD)
}

/// The plotted measures: force and torque at the instants, position and attitude after the longest roll-outs.
pub(super) fn measures(ladder: &[Rung]) -> Vec<Measure> {
    let lack = |of: fn(&Lack) -> Option<f64>| -> Vec<[Option<f64>; 2]> {
        ladder.iter().map(|r| [r.held_out_lack, r.training_lack].map(|l| l.and_then(|l| of(&l)))).collect()
    };
    let longest = super::text::horizons(ladder).last().copied();
    let after = |of: fn(&HorizonError) -> f64| -> Vec<[Option<f64>; 2]> {
        let at = |list: &[HorizonError]| longest.and_then(|h| super::text::at(list, h)).map(of);
        ladder.iter().map(|r| [at(&r.held_out), at(&r.training)]).collect()
    };
    let mut out = vec![
        Measure::new("force that the model lacks".into(), "N", lack(|l| Some(l.force_n))),
        Measure::new("torque that the model lacks".into(), "N·m", lack(|l| l.torque_n_m)),
    ];
    if let Some(h) = longest {
        let h = significant(h, 1);
        out.push(Measure::new(format!("position after {h} s"), "m", after(|e| e.position_m)));
        if turns(ladder) {
            out.push(Measure::new(format!("attitude after {h} s"), "rad", after(|e| e.attitude_rad)));
        }
    }
    out.into_iter().flatten().collect()
}
