//! Effects of other crates: written like those in this folder, made known by [`register`], and then in force wherever a vehicle
//! lists them, in vehicle files, simulations, environments and comparisons with flights.
//!
//! `examples/own_effect.rs` is a whole one.

use core::any::{Any, TypeId};
use std::sync::{PoisonError, RwLock};

use super::{Bounds, Candidate, Clock, Command, Effect, KINDS, Nature, Parts, Reading, Reads, View};
use crate::drone::Drone;
use crate::params::Parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Surroundings;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::trace::Sym;

/// Most numbers among the parameters of a custom effect.
pub const MAX_PARAMETERS: usize = 12;

/// Why an effect cannot be registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RegisterError {
    /// The name is that of another effect.
    #[error("effect {0}: there is one of this name already; choose another name")]
    Known(String),
    /// The name cannot stand in a vehicle file.
    #[error(
        "effect {0:?}: expected a name of small letters, digits and underscores that begins with a letter"
    )]
    Name(String),
    /// It has too many parameters.
    #[error("effect {kind}: expected at most {MAX_PARAMETERS} numbers as parameters, found {found}")]
    Parameters {
        /// Name of the effect.
        kind: String,
        /// Numbers that it has.
        found: usize,
    },
    /// Its bounds name a parameter that it does not have.
    #[error("effect {kind}: expected bounds of its parameters ({known}), found those of {parameter}")]
    Bounds {
        /// Name of the effect.
        kind: String,
        /// The name in its bounds.
        parameter: String,
        /// Its parameters.
        known: String,
    },
}

/// An effect of another crate, over every number type of this library.
pub struct Custom {
    kind: &'static str,
    type_id: TypeId,
    /// `.name` and `.name.index` of every number, with its default.
    parameters: Vec<(String, f64)>,
    candidates: fn(&Drone<f64>) -> Vec<Candidate>,
    /// [`Over`] one number type each.
    over: Vec<Box<dyn Any + Send + Sync>>,
}

impl core::fmt::Debug for Custom {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.kind)
    }
}

impl PartialEq for Custom {
    fn eq(&self, other: &Self) -> bool {
        self.kind == other.kind
    }
}

/// What is done with an effect.
type Act<'a, S> = &'a mut dyn FnMut(&dyn Effect<S>);

/// The effect over one number type: makes it of the values of its parameters, in their order, and hands it on.
struct Over<S: Real>(fn(&[S; MAX_PARAMETERS], Act<S>));

impl<S: Real> Over<S> {
    fn of<P>() -> Self
    where
        P: Parameters<f64> + Default,
        P::Over<S>: Effect<S>,
    {
        Self(|value, act| {
            let mut values = value.iter();
            act(&P::default().map(&mut |default| values.next().copied().unwrap_or(S::lit(default))));
        })
    }
}

static REGISTERED: RwLock<Vec<&'static Custom>> = RwLock::new(Vec::new());

fn registered() -> Vec<&'static Custom> {
    REGISTERED.read().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Names of all effects: those of this library and those that were registered.
pub fn kinds() -> Vec<&'static str> {
    KINDS.iter().copied().chain(registered().iter().map(|c| c.kind)).collect()
}

/// The registered effect of this name.
pub(super) fn find(kind: &str) -> Option<&'static Custom> {
    registered().into_iter().find(|c| c.kind == kind)
}

/// What registered effects may be missing in the model of `drone`.
pub(super) fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    registered().iter().flat_map(|c| (c.candidates)(drone)).collect()
}

macro_rules! register {
    ($($n:literal)*) => {
        /// Whether effects are made over a [`Dual`] of `n` derivatives.
        pub const fn differentiates(n: usize) -> bool {
            matches!(n, $($n)|*)
        }

        /// Makes an effect known under the name `kind`, as vehicle files spell it, for the whole program and for good. `P` is the struct of
        /// its parameters ([`parameters!`](crate::parameters)), over f64, with the defaults at which the effect does nothing;
        /// `candidates` says what of it may be missing in a model, by the same `kind`, or gives nothing.
        ///
        /// It acts on numbers of the types f32 and f64, on traces, and on duals of f64 with as many derivatives as [`differentiates`] says.
        /// Registering the same `P` under the same name again changes nothing.
        ///
        /// # Errors
        /// [`RegisterError`].
        pub fn register<P>(
            kind: &'static str,
            candidates: fn(&Drone<f64>) -> Vec<Candidate>,
        ) -> Result<(), RegisterError>
        where
            P: Parameters<f64> + Default + 'static,
            P::Over<f32>: Effect<f32>,
            P::Over<f64>: Effect<f64>,
            P::Over<Sym>: Effect<Sym>,
            $(P::Over<Dual<f64, $n>>: Effect<Dual<f64, $n>>,)*
        {
            let plain = P::default().map(&mut |v| v);
            let custom = checked::<P>(kind, candidates, plain.ranges())?;
            let over: Vec<Box<dyn Any + Send + Sync>> = vec![
                Box::new(Over::<f32>::of::<P>()),
                Box::new(Over::<f64>::of::<P>()),
                Box::new(Over::<Sym>::of::<P>()),
                $(Box::new(Over::<Dual<f64, $n>>::of::<P>()),)*
            ];
            keep(Custom { over, ..custom })
        }
    };
}

// An effect is compiled once for each, 24 of them in a minute: some small ones, and those of `crates/gap`.
register! { 1 2 3 4 5 6 12 13 19 }

fn checked<P: Parameters<f64> + Default + 'static>(
    kind: &'static str,
    candidates: fn(&Drone<f64>) -> Vec<Candidate>,
    ranges: &[(&str, Bounds)],
) -> Result<Custom, RegisterError> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !kind.starts_with(|c: char| c.is_ascii_lowercase()) || !kind.chars().all(plain) {
        return Err(RegisterError::Name(kind.into()));
    }
    let mut parameters = Vec::new();
    P::default().visit("", &mut |name, value| parameters.push((name.to_string(), *value)));
    if parameters.len() > MAX_PARAMETERS {
        return Err(RegisterError::Parameters { kind: kind.into(), found: parameters.len() });
    }
    let known: Vec<&str> = parameters.iter().filter_map(|(name, _)| name.split('.').nth(1)).collect();
    match ranges.iter().find(|(name, _)| !known.contains(name)) {
        Some((name, _)) => Err(RegisterError::Bounds {
            kind: kind.into(),
            parameter: (*name).into(),
            known: known.join(", "),
        }),
        None => Ok(Custom { kind, type_id: TypeId::of::<P>(), parameters, candidates, over: Vec::new() }),
    }
}

fn keep(custom: Custom) -> Result<(), RegisterError> {
    let mut list = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    match list.iter().find(|c| c.kind == custom.kind) {
        Some(known) if known.type_id == custom.type_id => Ok(()),
        _ if list.iter().any(|c| c.kind == custom.kind) || KINDS.contains(&custom.kind) => {
            Err(RegisterError::Known(custom.kind.into()))
        }
        _ => {
            // Effects are copied with their vehicles, so that they hold their kind by a reference that lives as long as the program.
            list.push(Box::leak(Box::new(custom)));
            Ok(())
        }
    }
}

/// A registered effect, with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params<S> {
    /// Values of its parameters, in their order; entries past the last one are 0.
    pub value: [S; MAX_PARAMETERS],
    /// What it is.
    pub custom: &'static Custom,
}

impl Params<f64> {
    /// The effect with its default parameters.
    pub(super) fn new(custom: &'static Custom) -> Self {
        let mut value = [0.0; MAX_PARAMETERS];
        for (to, (_, default)) in value.iter_mut().zip(&custom.parameters) {
            *to = *default;
        }
        Self { value, custom }
    }
}

impl<S> Params<S> {
    /// Its name, as vehicle files spell it.
    pub fn kind(&self) -> &'static str {
        self.custom.kind
    }
}

impl<S: Real> Params<S> {
    /// Does something with the effect over this number type.
    fn act<R>(&self, mut act: impl FnMut(&dyn Effect<S>) -> R) -> R {
        let mut out = None;
        if let Some(Over(with)) = self.custom.over.iter().find_map(|o| o.downcast_ref::<Over<S>>()) {
            with(&self.value, &mut |effect| out = Some(act(effect)));
        }
        out.unwrap_or_else(|| act(&Unknown))
    }
}

/// The effect over a number type that [`register`] does not make, of which the library has none: where it takes derivatives it
/// asserts that it [`differentiates`]. Forces that are no numbers show it; none at all would hide it.
struct Unknown;

impl<S: Real> Effect<S> for Unknown {
    fn wrench(&self, _: &View<S>, out: &mut Wrench<S>) {
        out.force = [S::lit(f64::NAN); 3];
    }
}

impl<S: Real> Parameters<S> for Params<S> {
    type Over<T: Real> = Params<T>;
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Params<T> {
        let n = self.custom.parameters.len();
        Params {
            value: core::array::from_fn(|i| if i < n { f(self.value[i]) } else { T::zero() }),
            custom: self.custom,
        }
    }
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        for ((name, _), value) in self.custom.parameters.iter().zip(&mut self.value) {
            f(&format!("{prefix}{name}"), value);
        }
    }
    fn numbers<F: FnMut(S)>(&self, f: &mut F) {
        self.value.iter().take(self.custom.parameters.len()).for_each(|v| f(*v));
    }
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
        self.value.iter_mut().take(self.custom.parameters.len()).for_each(f);
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        self.act(|e| e.nature())
    }
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        self.act(|e| e.ranges())
    }
    fn builds(&self) -> bool {
        self.act(|e| e.builds())
    }
    fn build(&self, parts: &mut Parts<S>) {
        self.act(|e| e.build(parts));
    }
    fn carried_kg(&self) -> S {
        self.act(|e| e.carried_kg())
    }
    fn memory_len(&self, dt_s: f64) -> usize {
        self.act(|e| e.memory_len(dt_s))
    }
    fn reads(&self) -> Reads {
        self.act(|e| e.reads())
    }
    fn air(&self, view: &View<S>) -> [S; 3] {
        self.act(|e| e.air(view))
    }
    fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
        self.act(|e| e.thrust_gain(view, hub_m))
    }
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        self.act(|e| e.wrench(view, out));
    }
    fn start(&self, command: &Command<S>, memory: &mut [S]) {
        self.act(|e| e.start(command, memory));
    }
    fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        self.act(|e| e.command(view, dt_s, command, memory));
    }
    fn battery_v(&self, view: &View<S>, command: &Command<S>, memory: &[S]) -> Option<S> {
        self.act(|e| e.battery_v(view, command, memory))
    }
    fn controls(&self) -> bool {
        self.act(|e| e.controls())
    }
    fn delay_s(&self) -> Option<S> {
        self.act(|e| e.delay_s())
    }
    fn surround(&self, memory: &[S], surroundings: &mut Surroundings<S>) {
        self.act(|e| e.surround(memory, surroundings));
    }
    fn measure(&self, reading: &mut Reading<S>) {
        self.act(|e| e.measure(reading));
    }
    fn clock(&self) -> Clock<S> {
        self.act(|e| e.clock())
    }
}
