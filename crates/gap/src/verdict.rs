//! Result of a diagnosis: plain data for text, JSON and pages.

use super::decide::rules::{Rule, Why};
use super::formula::Formula;
use super::headline::since;
use super::moments::{Moment, words};
use super::network::NetworkVerdict;
use super::opinion;
use super::policy::FAR_TOLERANCES;
use super::track::Noise;
use propwash_physics::effects::Area;
use serde::{Deserialize, Serialize};

/// A fitted parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterFit {
    /// Name within the effect: `drag_n_s_per_m.0.0`.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Nominal value: that of the vehicle file (the effect's default where the file does not list it).
    pub filed: f64,
    /// Estimate.
    pub value: f64,
    /// Standard deviation of the estimate.
    pub sigma: f64,
}

/// An effect that fits almost as well as the chosen one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LookAlike {
    /// Candidate ids that together replace the chosen effect.
    pub ids: Vec<String>,
    /// In plain words.
    pub title: String,
    /// Evidence deficit to the chosen effect, nats.
    pub worse_by_nats: f64,
    /// The manoeuvre that would separate them.
    pub manoeuvre: String,
}

/// Opinion of the second estimator on a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// It improves held-out flight, and the values agree.
    Agrees,
    /// The second estimator would see the claimed effect, and sees something else.
    Differs,
    /// The pilot's reaction to disturbances could look the same.
    Answer,
    /// The second estimator cannot observe such an effect.
    Silent,
    /// The same, and the effect would have to be larger than such errors of sensors and clocks are.
    TooLarge,
}

/// A step of the second estimator's own selection.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SecondStep {
    /// Candidate id.
    pub id: String,
    /// Share of the force or torque left by the previous steps that it explains on flight held out from the regression.
    pub gain: f64,
    /// Its standard error.
    pub gain_sigma: f64,
    /// Whether its values are within the vehicle's tolerances.
    pub within_tolerance: bool,
}

impl Said {
    /// In words that follow "the second estimator".
    pub fn words(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Differs => "differs",
            Self::Answer => "cannot tell it from the pilot's answer to the weather",
            Self::Silent => "says nothing of it",
            Self::TooLarge => "says nothing of it, and it is larger than such errors are",
        }
    }
}

/// The second line of evidence: a band-limited regression of force and torque, which needs no model of sensor noise and no
/// initial states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opinion {
    /// Whether it agrees with the fit.
    pub said: Said,
    /// Share of the force or torque left by the others that the effect explains on flight held out from the regression.
    pub gain: Option<f64>,
    /// Its standard error, by the scatter between blocks of flight.
    pub gain_sigma: Option<f64>,
    /// In words, with both numbers where they differ.
    pub text: String,
}

/// An effect that the verdict names.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Candidate id: `weak_rotor.2`.
    pub id: String,
    /// Effect kind: `weak_rotor`.
    pub kind: String,
    /// In plain words.
    pub title: String,
    /// Where it acts.
    pub area: Area,
    /// Parameters with values and intervals.
    pub parameters: Vec<ParameterFit>,
    /// Other parameters of the effect that were set before the fit (a cable's length), SI.
    pub set: Vec<(String, f64)>,
    /// Evidence that is lost without it, nats.
    pub evidence_nats: f64,
    /// Share of the excess error that it removes on held-out windows, 0 to 1; negative: it makes it worse.
    pub removed_share: f64,
    /// Whether no other effect explains the log about as well, and the second estimator does not object.
    pub certain: bool,
    /// Opinion of the second estimator.
    pub second: Opinion,
    /// Effects that the log cannot separate from it.
    pub look_alikes: Vec<LookAlike>,
    /// Effects indistinguishable from it, or from a look-alike, with this drive: without rotor speeds drag of the rotors is
    /// drag of the body.
    pub stands_for: Vec<String>,
    /// Its effect on the held-out errors; null where that was not measured.
    pub held_out: Option<HeldOut>,
    /// Whether only the values that the logs have each for itself are off the file, and what they have in common is not: winds
    /// of two days that were opposite. The evidence is that of one log, and the share of the excess error is not known.
    #[serde(default)]
    pub each_log: bool,
}

/// Effect of a finding on a vehicle's held-out errors: the vehicle with everything written, and the same without this
/// finding (with it, for one that is not written).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeldOut {
    /// The channel on which it acts most: `force across the rotors`, `torque about body z`, `attitude after 0.5 s`.
    pub channel: String,
    /// SI unit of the channel.
    pub unit: String,
    /// Error of the channel without the finding, root mean square.
    pub without: f64,
    /// Error of the channel with the finding.
    pub with: f64,
    /// Both over the sensor noise; null where that is unknown.
    pub times_noise: Option<[f64; 2]>,
    /// Errors of position and attitude after 0.5 and 1 s with it, over those without it: geometric mean.
    pub roll_outs: f64,
    /// Whether it is written into the vehicle file, which is then no worse.
    pub written: bool,
    /// Why it is not written, with the numbers; null where it is.
    pub doubt: Option<String>,
    /// Why it is not written (it lowers the errors too little, or may be the clocks of the one log) is no evidence against its existence.
    #[serde(default)]
    pub little: bool,
}

impl Calibration {
    /// How many tolerances it is off; zero where that is unknown.
    pub fn times_tolerance(&self) -> f64 {
        let off = (self.parameter.value - self.parameter.filed).abs();
        if self.tolerance > 0.0 { off / self.tolerance } else { 0.0 }
    }

    /// Whether it is no longer called within tolerance.
    pub fn far(&self) -> bool {
        self.times_tolerance() > FAR_TOLERANCES
    }
}

impl Finding {
    /// Why it is in doubt and not written, if so.
    pub fn doubt(&self) -> Option<&str> {
        self.held_out.as_ref().filter(|h| !h.little).and_then(|h| h.doubt.as_deref())
    }

    /// Whether it or one of its look-alikes is missing for certain: the second estimator agrees, or cannot see it and there is much
    /// evidence.
    pub fn one_of_several(&self) -> bool {
        !self.look_alikes.is_empty() && opinion::certain(self.second.said, self.evidence_nats)
    }

    /// Why it is not written, if so: it is in doubt, or lowers the errors too little.
    pub fn unwritten(&self) -> Option<&str> {
        self.held_out.as_ref().and_then(|h| h.doubt.as_deref())
    }
}

/// A parameter within its tolerance whose estimate differs from the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Candidate id.
    pub id: String,
    /// Effect kind.
    pub kind: String,
    /// Where it acts.
    pub area: Area,
    /// The parameter.
    pub parameter: ParameterFit,
    /// Other parameters of the effect that were set before the fit (the speed at which a thrust curve is fixed), SI.
    #[serde(default)]
    pub set: Vec<(String, f64)>,
    /// Tolerance of a carefully built vehicle (standard deviation), in the unit of the parameter.
    #[serde(default)]
    pub tolerance: f64,
    /// Whether its group of parameters lowers the held-out error.
    #[serde(default)]
    pub helps: bool,
    /// Whether its group is written with the findings, since a held-out error rises without it.
    #[serde(default)]
    pub partner: bool,
}

/// A term of the free-form description of the remainder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FreeTerm {
    /// The component: `force along body x`, `torque about body z` …
    pub on: String,
    /// The physical variable: `v_x |v|`, `sin(2 roll) · thrust` …
    pub variable: String,
    /// Coefficient, per SI unit of the variable, of an acceleration (m/s² or rad/s²).
    pub coefficient: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Share of the remaining scatter that it explains on held-out blocks.
    pub explained_share: f64,
}

/// What remains with all findings in the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remainder {
    /// Standard deviation of the force that no effect explains, over the mass, m/s² (constant over 0.25 s).
    pub force_m_s2: f64,
    /// Standard deviation of the torque that no effect explains, over the inertia, rad/s²; zero where the attitude is an
    /// input and torques are unknown.
    pub torque_rad_s2: f64,
    /// The same without findings.
    pub force_before_m_s2: f64,
    /// The same without findings.
    pub torque_before_rad_s2: f64,
    /// Residual force over mass on which poses and inertial data agree, m/s²; null where one of them is missing.
    pub force_agreed_m_s2: Option<f64>,
    /// Residual torque over inertia on which attitude and gyroscope agree, rad/s²; null where one of them is missing.
    pub torque_agreed_rad_s2: Option<f64>,
    /// Whether more is left than for a well-known vehicle: something is missing that is not in the list.
    pub unexplained: bool,
    /// Whether that shows in all windows together only, being below the noise of each of them.
    pub faint: bool,
    /// Terms that describe it, best first.
    pub terms: Vec<FreeTerm>,
    /// In words.
    pub text: String,
}

/// How large an effect could be without showing in the logs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Candidate id.
    pub id: String,
    /// Name of its first parameter.
    pub parameter: String,
    /// SI unit.
    pub unit: String,
    /// Size up to which it would not show: a root mean square, like the plausible size; `None` where the logs have no
    /// information.
    pub size: Option<f64>,
    /// The same as a share of its plausible size.
    pub share: Option<f64>,
    /// Whether one of plausible size would show.
    pub visible: bool,
}

/// What to fly next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// Purpose, and what the manoeuvres would achieve.
    pub text: String,
    /// Manoeuvres of the library, best first; empty where none is known to help.
    pub manoeuvres: Vec<String>,
}

impl Lack {
    /// Root mean squares over the means of several stretches of flight; `None` where there is none.
    pub(crate) fn together(all: &[Self]) -> Option<Self> {
        let n: usize = all.iter().map(|l| l.n).sum();
        let mean = |of: &dyn Fn(&Self) -> Option<f64>| {
            let known: Vec<(f64, f64)> = all.iter().filter_map(|l| Some((of(l)?, l.n as f64))).collect();
            let count: f64 = known.iter().map(|k| k.1).sum();
            (count > 0.0).then(|| (known.iter().map(|(v, n)| v * v * n).sum::<f64>() / count).sqrt())
        };
        Some(Self {
            force_n: mean(&|l| Some(l.force_n))?,
            force_times_noise: mean(&|l| Some(l.force_times_noise))?,
            torque_n_m: mean(&|l| l.torque_n_m),
            torque_times_noise: mean(&|l| l.torque_times_noise),
            n,
        })
    }
}

/// Root-mean-square error of roll-outs of one length.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HorizonError {
    /// Length of the roll-outs, s.
    pub horizon_s: f64,
    /// Position at the end, m.
    pub position_m: f64,
    /// Velocity at the end, m/s.
    pub velocity_m_s: f64,
    /// Attitude at the end, rad; omitted from files where it is an input.
    #[serde(skip_serializing_if = "fed_in")]
    pub attitude_rad: f64,
    /// Body rate at the end, rad/s; omitted from files where it is an input.
    #[serde(skip_serializing_if = "fed_in")]
    pub rate_rad_s: f64,
    /// Number of roll-outs.
    pub n: usize,
}

/// Whether an error of attitude (rad) or body rate (rad/s) is mere rounding: the channel is an input of the model.
fn fed_in(error: &f64) -> bool {
    error.abs() <= super::policy::FED_IN_RAD
}

/// One step of the ladder: the model with the first findings added.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rung {
    /// `as filed`, `+ linear_drag` …
    pub label: String,
    /// Errors on the flights of the fit, by horizon.
    pub training: Vec<HorizonError>,
    /// Errors on held-out flight, by horizon.
    pub held_out: Vec<HorizonError>,
    /// Force and torque that the model lacks at the instants of the flights of the fit.
    pub training_lack: Option<Lack>,
    /// The same on held-out flight.
    pub held_out_lack: Option<Lack>,
}

impl Rung {
    /// Roll-out errors and missing force and torque on the flight used for judging: held-out flight if there is any.
    pub fn judged(&self) -> (&[HorizonError], Option<Lack>) {
        match self.held_out.is_empty() {
            false => (&self.held_out, self.held_out_lack),
            true => (&self.training, self.training_lack),
        }
    }
}

/// Force and torque that a model lacks at the instants of a flight, means over 50 ms: root mean squares of their lengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lack {
    /// Force, N.
    pub force_n: f64,
    /// Force over the sensor noise.
    pub force_times_noise: f64,
    /// Torque, N·m; null where the drive carries no torques.
    pub torque_n_m: Option<f64>,
    /// Torque over the sensor noise.
    pub torque_times_noise: Option<f64>,
    /// Number of means.
    pub n: usize,
}

/// One log of a diagnosis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogSummary {
    /// File name.
    pub name: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Usable span, s.
    pub duration_s: f64,
    /// Drive of the model.
    pub drive: String,
    /// Noise of its channels.
    pub noise: Noise,
    /// Whether it was held out from the fit.
    pub held_out: bool,
}

/// A parameter in which a log differs from the others of its diagnosis: a clock, a bias, the wind of the day.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OfOneLog {
    /// Name of the log.
    pub log: String,
    /// Candidate id.
    pub id: String,
    /// Name of the parameter.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Its value in this log, SI.
    pub value: f64,
    /// Its value in all logs together, SI.
    pub shared: f64,
    /// Standard deviation of the difference, SI.
    pub sigma: f64,
}

/// The flight before, between or after moments at which something changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Section {
    /// The logs, each with its part: `flight.csv to 17.1 s`.
    pub logs: Vec<String>,
    /// The verdict on it in at most 90 characters; where it could not be diagnosed, why.
    pub headline: String,
    /// The whole sentence.
    pub verdict: String,
    /// What is missing from the file there.
    pub findings: Vec<Finding>,
    /// Whether something is left there that nothing explains.
    pub unexplained: bool,
    /// Whether it was diagnosed.
    pub fitted: bool,
}

/// The verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Name of the vehicle.
    pub vehicle: String,
    /// SHA-256 of its file's contents.
    pub vehicle_sha256: String,
    /// Dynamics of the vehicle that were fitted, one of [`propwash_vehicle::DYNAMICS`].
    pub dynamics: String,
    /// The logs.
    pub logs: Vec<LogSummary>,
    /// One sentence: what is missing, or that nothing is.
    pub verdict: String,
    /// The same in at most 90 characters.
    pub headline: String,
    /// The missing effects, most important first; empty where nothing is missing.
    pub findings: Vec<Finding>,
    /// Formulas among the findings, for physics that is not in the list: their tables of a vehicle file.
    pub formulas: Vec<Formula>,
    /// What became of the search for a small network; null where none was asked for.
    pub network: Option<NetworkVerdict>,
    /// Why each effect is named, in doubt or not named, in the order of the decisions.
    pub why: Vec<Why>,
    /// Parameters within tolerance that the log moves by more than two standard deviations.
    pub calibration: Vec<Calibration>,
    /// All tolerance parameters at their estimates, including those of the sensors, for a vehicle file that is calibrated
    /// as well as completed: they are correlated and only valid together.
    pub adjusted: Vec<Calibration>,
    /// What remains.
    pub remainder: Remainder,
    /// Nominal, + effect 1, + effect 2 …
    pub ladder: Vec<Rung>,
    /// What to fly next, and why.
    pub advice: Vec<Advice>,
    /// How large each candidate that was tried and not found could be without showing, the least visible first.
    pub limits: Vec<Limit>,
    /// Candidates that were not tried, with the reason.
    pub not_tried: Vec<(String, String)>,
    /// Every candidate tried alone: id, evidence for it, nats.
    pub singles: Vec<(String, f64)>,
    /// The second estimator's own selection, largest gain first.
    pub second: Vec<SecondStep>,
    /// Dispersion (reduced chi-square) by which evidence and intervals were scaled (1: residuals as noisy as the sensors).
    pub dispersion: f64,
    /// Parameters in which the logs differ from each other, where there are several.
    pub per_log: Vec<OfOneLog>,
    /// Moments at which something changed in mid-flight, in the order of the logs and of time.
    pub moments: Vec<Moment>,
    /// Where there are moments: the flight before, between and after them, each diagnosed by itself. Everything else of the diagnosis is
    /// about the last of them that could be diagnosed, but for `ladder`, which is over all of them.
    pub sections: Vec<Section>,
    /// Assumptions and omissions.
    pub warnings: Vec<String>,
}

impl Diagnosis {
    /// The flight on which findings and ladder steps are judged: held-out flight if there is any.
    pub fn judged_on(&self) -> &'static str {
        match self.logs.iter().any(|l| l.held_out) {
            true => "held-out flight",
            false => "flight used for the fit",
        }
    }

    /// Says what changed in mid-flight, and puts in doubt what was found as if nothing had.
    pub(crate) fn doubt_by_moments(&mut self) {
        if self.moments.is_empty() {
            return;
        }
        let told = words::list(&self.moments, words::sentence);
        for f in self.findings.iter_mut() {
            f.certain = false;
            self.why.push(Why::new(
                &f.id,
                Rule::Moment,
                format!("in doubt: {}", words::list(&self.moments, words::short)),
            ));
        }
        self.verdict = format!("{told}; as one flight: {}", self.verdict);
        self.headline = self.beside_moments(&self.headline);
    }

    /// A headline, after what changed in mid-flight.
    pub(crate) fn beside_moments(&self, headline: &str) -> String {
        match self.moments.is_empty() {
            true => headline.to_string(),
            false => since(self.moments.len(), &words::list(&self.moments, words::short), headline),
        }
    }

    /// Manoeuvres of the library to fly next, each once, most useful first.
    pub fn next_flight(&self) -> Vec<String> {
        let mut out: Vec<String> = Vec::new();
        for name in self.advice.iter().flat_map(|a| &a.manoeuvres) {
            if !out.contains(name) {
                out.push(name.clone());
            }
        }
        out
    }
}
