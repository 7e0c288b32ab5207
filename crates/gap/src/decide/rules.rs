//! The rules that decide a verdict: statement, threshold, and the flights that set it.

use crate::policy::{
    CERTAIN_ALONE_NATS, EVENTFUL, FORMULA_NATS, FORMULA_SHARE, LEANING, LEAST_SHARE, LEAST_SHARE_ALONE,
    LITTLE_GAIN, LOST_NATS, MOMENT_NATS, MOMENT_SHARE, NAMED_SIGMAS, NETWORK_SIGMAS, RISES, RISES_IN_PART,
    WELL_BELOW,
};
use crate::search::THRESHOLD;
use serde::Serialize;

/// A rule that decides whether an effect is named, and how certain it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Enough evidence to be named.
    Evidence,
    /// Removes too little of the held-out error.
    LittleGain,
    /// Lost its evidence in the last fit.
    EvidenceLost,
    /// Its interval contains zero.
    MayBeNothing,
    /// Both estimators agree.
    TwoEstimators,
    /// Only the fit can observe it.
    SeenByOne,
    /// Only the fit can observe it, and it is larger than such errors are.
    TooLargeAlone,
    /// Another effect fits as well.
    LookAlikes,
    /// Its residual has the shape of another effect.
    OtherShape,
    /// All findings together explain too little.
    Leaning,
    /// The remainder is turbulence.
    Weather,
    /// Forces are larger with the findings than without.
    ForcesGrow,
    /// Observed by one estimator only, beside an unexplained remainder.
    BesideUnexplained,
    /// Would make the vehicle worse on held-out flight.
    NeverWorse,
    /// A formula for what is in no list.
    Formula,
    /// A small network for what no formula fits.
    Network,
    /// A drift from flight to flight ([`crate::drift`]).
    Drift,
    /// Something changed in mid-flight ([`crate::moments`]).
    Moment,
}

impl Rule {
    /// All of them, in the order in which they are applied.
    pub const ALL: [Self; 18] = [
        Self::Evidence,
        Self::LittleGain,
        Self::EvidenceLost,
        Self::MayBeNothing,
        Self::TwoEstimators,
        Self::SeenByOne,
        Self::TooLargeAlone,
        Self::LookAlikes,
        Self::OtherShape,
        Self::Leaning,
        Self::Weather,
        Self::ForcesGrow,
        Self::BesideUnexplained,
        Self::NeverWorse,
        Self::Formula,
        Self::Network,
        Self::Drift,
        Self::Moment,
    ];

    /// Its name in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Evidence => "evidence",
            Self::LittleGain => "little gain",
            Self::EvidenceLost => "evidence lost",
            Self::MayBeNothing => "may be nothing",
            Self::TwoEstimators => "two estimators",
            Self::SeenByOne => "seen by one",
            Self::TooLargeAlone => "too large alone",
            Self::LookAlikes => "look-alikes",
            Self::OtherShape => "other shape",
            Self::Leaning => "leaning",
            Self::Weather => "weather",
            Self::ForcesGrow => "forces grow",
            Self::BesideUnexplained => "beside unexplained",
            Self::NeverWorse => "never worse",
            Self::Formula => "formula",
            Self::Network => "network",
            Self::Drift => "drift",
            Self::Moment => "moment",
        }
    }

    /// What it states, with its thresholds.
    pub fn statement(self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        match self {
            Self::Evidence => format!("an effect is named that brings {THRESHOLD} nats and more beside the others"),
            Self::LittleGain => format!(
                "one that takes less than {} of the excess error on windows that the fit has not seen ({} where it stands \
                 alone) is left out",
                percent(LEAST_SHARE),
                percent(LEAST_SHARE_ALONE)
            ),
            Self::EvidenceLost => format!(
                "one that brings less than {LOST_NATS} nats once the model has moved to all its estimates is left out"
            ),
            Self::MayBeNothing => format!(
                "one whose numbers are all within {NAMED_SIGMAS} standard deviations of the file is left out"
            ),
            Self::TwoEstimators => {
                "an effect is certain where fit and regression agree, in doubt where they differ".into()
            }
            Self::SeenByOne => format!(
                "what the regression cannot see is certain from {CERTAIN_ALONE_NATS} nats on"
            ),
            Self::TooLargeAlone => {
                "what the regression cannot see is in doubt where it is larger than such sensors are off".into()
            }
            Self::LookAlikes => format!("nothing is certain that something else fits within {THRESHOLD} nats"),
            Self::OtherShape => {
                "an effect of the air is taken back with what was found beside it on less evidence where a shape outside the \
                 list fits better, or where it leaves a clear shape of its own; in the second case what the regression \
                 agrees on stays, in doubt"
                    .into()
            }
            Self::Leaning => format!(
                "where something is unexplained, findings that take less than half of the error on unseen windows, or {} \
                 of the disturbances' variance ({} beside an event), are taken back",
                percent(LEANING),
                percent(EVENTFUL)
            ),
            Self::Weather => {
                "a force without pattern, of the size of wind on this vehicle, is turbulence, and takes nothing away".into()
            }
            Self::ForcesGrow => {
                "by thrust, findings with which more force is left than without them are taken back".into()
            }
            Self::BesideUnexplained => {
                "beside something unexplained, or a formula of the search, what only one estimator sees is in doubt".into()
            }
            Self::NeverWorse => format!(
                "nothing is written with which an error on unseen flight rises, by more than {:.0} %, or which makes all \
                 errors together worse; where something is unexplained, all errors together must fall to {} in every \
                 third of that flight, and none may rise by more than {:.0} % in any",
                100.0 * (RISES - 1.0),
                percent(WELL_BELOW),
                100.0 * (RISES_IN_PART - 1.0)
            ),
            Self::Formula | Self::Network | Self::Drift | Self::Moment => self.statement_beyond(),
        }
    }

    /// The same of the rules about what is in no list, and about what changes.
    fn statement_beyond(self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        match self {
            Self::Formula => format!(
                "where something is unexplained, a formula is tried that describes {} and more of what the windows lack and \
                 brings {FORMULA_NATS} nats; it is named if the search then chooses it and the errors on unseen flight fall to {} of \
                 those of what would be written without it",
                percent(FORMULA_SHARE),
                percent(LITTLE_GAIN)
            ),
            Self::Network => format!(
                "on request, a small network is fitted to what is left beside all tolerances at their estimates, where it brings \
                 {FORMULA_NATS} nats and {NETWORK_SIGMAS} standard errors between stretches of time that its fit has not seen; it is written \
                 if the errors on unseen flight then fall to {} and none rises by more than {:.0} %",
                percent(LITTLE_GAIN),
                100.0 * (RISES - 1.0)
            ),
            Self::Drift => format!(
                "from flight to flight a drift of an effect is named that brings {THRESHOLD} nats, averaged over the logs in which it may \
                 have begun; it is accepted if with it the errors on unseen flight of the newest log fall to {} in its channel or all \
                 together, and where that log leaves something unexplained only if its verdict is certain of the effect and nothing of \
                 it was accepted before",
                percent(LITTLE_GAIN)
            ),
            _ => format!(
                "a step of an effect in mid-flight is named that brings {MOMENT_NATS} nats beyond the price of all effects and times that \
                 were compared, the weather being estimated again with it, and {THRESHOLD} nats more than the same effect going steadily \
                 from one value to another, if the steps of a flight together take {} of the variance of what it leaves; what was found as if nothing had changed is then in doubt, and the flight before and after \
                 is diagnosed by itself",
                percent(MOMENT_SHARE)
            ),
        }
    }

    /// Flights that set it, as far as recorded.
    pub fn set_by(self) -> &'static str {
        match self {
            Self::Evidence | Self::LittleGain | Self::LookAlikes | Self::OtherShape | Self::Leaning => {
                "the planted flights of `bench gap`: one effect, two, none, and effects that are not in the list"
            }
            Self::EvidenceLost => "a real flight with a slung load, where a clock stayed with −1 nats",
            Self::MayBeNothing => {
                "a planted downwash, beside which a wind of −0.25 ± 0.20 m/s stood with 13 nats"
            }
            Self::TwoEstimators => "real flights of a Crazyflie Brushless, of Blackbird and of a slung load",
            Self::SeenByOne => {
                "real flights: a tilt of the world of 27 nats and a marker of 18, of which nothing is known"
            }
            Self::TooLargeAlone => {
                "planted flights with filtered poses, where a gyroscope's scale of 0.83 and 1.12 stood with 66 and 79 nats, and a load on a \
                 cable in MuJoCo that nobody tracked, which looked like a marker 113 mm off"
            }
            Self::Weather => "planted turbulence beside a weak rotor, a fading thrust and a slung load",
            Self::ForcesGrow => "20 planted flights by thrust with filtered sensors, 14 of them right before",
            Self::BesideUnexplained => {
                "flights of MuJoCo with dry friction, which leads the velocity there: beside its formula stood an accelerometer's clock"
            }
            Self::Formula => "planted flights with effects that are in no list, and with none",
            Self::Network => "planted flights with effects that no formula describes, and with none",
            Self::Drift => {
                "48 planted flights of six vehicles with another wind and battery in each, which name none; six flights of a Crazyflie \
                 Brushless with something unexplained, which named ten"
            }
            Self::Moment => {
                "46 steady planted flights of two vehicles, which name none with it; nine with effects in no list, whose steps take at \
                 most 62 % of what the flight leaves; 16 in which an effect comes, whose steps take 90 % and more"
            }
            Self::NeverWorse => "18 planted flights, in 4 of which what was written raised an error",
        }
    }
}

/// Why an effect is named, in doubt or not named.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Why {
    /// Id of the effect.
    pub id: String,
    /// The rule that decided.
    pub rule: Rule,
    /// What it decided, with the numbers.
    pub text: String,
}

impl Why {
    /// A reason.
    pub(crate) fn new(id: &str, rule: Rule, text: impl Into<String>) -> Self {
        Self { id: id.into(), rule, text: text.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_has_its_own_statement_and_flights_that_set_it() {
        let mut said: Vec<String> = Rule::ALL.iter().map(|r| r.statement()).collect();
        assert!(said.iter().all(|s| s.len() > 30) && Rule::ALL.iter().all(|r| r.set_by().len() > 15));
        said.sort();
        said.dedup();
        assert_eq!(said.len(), Rule::ALL.len());
        assert!(Rule::Evidence.statement().contains("6 nats"), "{}", Rule::Evidence.statement());
        assert!(Rule::NeverWorse.statement().contains("1 %"), "{}", Rule::NeverWorse.statement());
    }
}
