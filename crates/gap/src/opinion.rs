//! The second estimator's opinion of each finding, in words and numbers.

use super::model::Model;
use super::policy::CERTAIN_ALONE_NATS;
use super::report::{interval, quantity};
use super::solve::{Solution, larger_than};
use super::verdict::{Opinion, Said, SecondStep};
use super::witness::{Agreement, Testimony, Witness, agreement};
use propwash_physics::effects::Area;

/// Opinion of the second estimator on candidate `c` of a solution.
pub(super) fn of(model: &Model, witness: &Witness, solution: &Solution, c: usize) -> Opinion {
    let Some(testimony) = witness.testimony(&solution.set, c) else {
        // For example wind beside a vehicle without nominal drag.
        let area = model.candidates[c].area;
        if larger_than(model, solution, c, model.candidates[c].most_slabs) {
            let text = "says nothing of sensors, and few are off by so much: filtered measurements, or a load nobody \
                        tracked, can look the same";
            return Opinion { said: Said::TooLarge, ..silent(text) };
        }
        return silent(if area == Area::Airframe {
            "makes no force or torque that varies on the vehicle as filed, so that a regression says nothing of it"
        } else {
            "acts on sensors, clocks or limits, of which a regression of forces and torques says nothing"
        });
    };
    let posterior = &solution.posterior;
    let said = agreement(&testimony, &posterior.mean, &posterior.sigma);
    let words = |k: usize, value: f64, sigma: f64| {
        let p = &model.parameters[k];
        format!("{} {}", p.name, interval(value, sigma, p.unit))
    };
    let share = format!(
        "explains {:.0} % of the {} that is left on other flight",
        100.0 * testimony.gain,
        group(&testimony)
    );
    match said {
        Agreement::Agrees => opinion(Said::Agrees, &testimony, format!("agrees: {share}")),
        Agreement::Differs { parameter, claimed, found, sigma, gains } => {
            let gain = if gains { share } else { format!("no gain on other flight ({share})") };
            let text = format!(
                "differs: {} by the regression, {} by the fit; {gain}",
                words(parameter, found, sigma),
                quantity(claimed, model.parameters[parameter].unit, 3)
            );
            opinion(Said::Differs, &testimony, text)
        }
        Agreement::Mute if testimony.could_be_an_answer() => opinion(
            Said::Answer,
            &testimony,
            format!("cannot tell it from what the pilot does against the weather: {share}"),
        ),
        Agreement::Mute => silent("could not see an effect of this size"),
    }
}

/// Whether a finding without look-alikes is certain: both estimators agree, or the second cannot observe it and the
/// evidence is strong.
pub(super) fn certain(second: Said, nats: f64) -> bool {
    match second {
        Said::Agrees => true,
        Said::Silent => nats >= CERTAIN_ALONE_NATS,
        Said::Differs | Said::Answer | Said::TooLarge => false,
    }
}

fn group(testimony: &Testimony) -> &'static str {
    if testimony.by_turning { "torque" } else { "force" }
}

fn opinion(said: Said, testimony: &Testimony, text: String) -> Opinion {
    Opinion { said, gain: Some(testimony.gain), gain_sigma: Some(testimony.gain_sigma), text }
}

fn silent(text: &str) -> Opinion {
    Opinion { said: Said::Silent, gain: None, gain_sigma: None, text: text.into() }
}

/// For turbulence, which has no pattern to regress on.
pub(super) fn weather() -> Opinion {
    silent("weather has no pattern that a regression could find")
}

/// For what logs have each for itself.
pub(super) fn each_log() -> Opinion {
    silent("regresses on what the logs have in common, and they have nothing of it in common")
}

/// The second estimator's own selection.
pub(super) fn selection(model: &Model, witness: &Witness) -> Vec<SecondStep> {
    let step = |s: super::witness::Step| SecondStep {
        id: model.candidates[s.candidate].id.clone(),
        gain: s.gain,
        gain_sigma: s.gain_sigma,
        within_tolerance: s.within_tolerance,
    };
    witness.search().into_iter().map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_second_estimator_cannot_see_asks_for_much_evidence() {
        assert!(certain(Said::Agrees, 7.0));
        assert!(
            !certain(Said::Silent, CERTAIN_ALONE_NATS - 1.0) && certain(Said::Silent, CERTAIN_ALONE_NATS)
        );
        assert!([Said::Differs, Said::Answer, Said::TooLarge].into_iter().all(|said| !certain(said, 1e3)));
    }
}
