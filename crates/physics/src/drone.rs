//! One vehicle put together: rigid body, rotors or the abstracted response, effects.

use super::airframe;
use super::attitude_response;
use super::controllers::mellinger;
use super::effects::{AnyEffect, Command, Effect, Parts, View};
use super::measure::{Clock, Reading};
use super::params::Parameters;
use super::rigid_body::{self, MAX_ROTORS, Rate, State, Wrench};
use super::rotor;
use super::surroundings::{Reads, Surroundings};
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

/// How commands become motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dynamics<S> {
    /// Rotor speeds make thrust and torque (first principles).
    Rotors,
    /// Attitude and thrust commands are answered by fitted second-order systems.
    AttitudeResponse(attitude_response::Params<S>),
}

/// What a measurement says about the drive of a vehicle; see [`Drone::rate_measured`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measured<S> {
    /// The rotors' accelerations, rad/s²; their speeds are in the state.
    RotorAcc([S; MAX_ROTORS]),
    /// Collective thrust before what effects do to it, N.
    Thrust(S),
}

/// What drives a vehicle.
enum Drive<'a, S> {
    Command(&'a Command<S>),
    RotorAcc(&'a [S; MAX_ROTORS]),
    Thrust(S),
}

impl<S: Real> Drive<'_, S> {
    /// Collective thrust where it is known without rotors, N.
    #[inline(always)]
    fn collective_n(&self, response: Option<&attitude_response::Params<S>>, state: &State<S>) -> Option<S> {
        match (response, self) {
            (Some(p), Drive::Command(Command::Attitude(c))) => {
                Some(attitude_response::thrust(p, state.thrust, c[3]))
            }
            (_, Drive::Thrust(thrust)) => Some(*thrust),
            _ => None,
        }
    }
}

/// All parameters of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Drone<S> {
    /// Mass properties.
    pub body: rigid_body::Params<S>,
    /// Rotors.
    pub airframe: airframe::Params<S>,
    /// How commands become motion.
    pub dynamics: Dynamics<S>,
    /// On-board controller.
    pub controller: mellinger::Params<S>,
    /// What else acts, in order.
    pub effects: Vec<AnyEffect<S>>,
}

impl<S: Real> Drone<S> {
    /// The same vehicle over another number type.
    pub fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Drone<T> {
        Drone {
            body: self.body.map(f),
            airframe: self.airframe.map(f),
            dynamics: match &self.dynamics {
                Dynamics::Rotors => Dynamics::Rotors,
                Dynamics::AttitudeResponse(p) => Dynamics::AttitudeResponse(p.map(f)),
            },
            controller: self.controller.map(f),
            effects: self.effects.iter().map(|e| e.map(f)).collect(),
        }
    }

    /// Every number in the order of [`Drone::map`].
    pub fn numbers(&self, f: &mut impl FnMut(S)) {
        self.body.numbers(f);
        self.airframe.numbers(f);
        if let Dynamics::AttitudeResponse(p) = &self.dynamics {
            p.numbers(f);
        }
        self.controller.numbers(f);
        self.effects.iter().for_each(|effect| effect.numbers(f));
    }

    /// The same, to change them; call [`Drone::refresh`] afterwards.
    pub fn numbers_mut(&mut self, f: &mut impl FnMut(&mut S)) {
        self.body.numbers_mut(f);
        self.airframe.numbers_mut(f);
        if let Dynamics::AttitudeResponse(p) = &mut self.dynamics {
            p.numbers_mut(f);
        }
        self.controller.numbers_mut(f);
        self.effects.iter_mut().for_each(|effect| effect.numbers_mut(f));
    }

    /// `f(name, value)` for every parameter: `body.mass_kg`, `rotors.0.spin_up.1`, `effect.linear_drag.drag_n_s_per_m.0.0`,
    /// `effect.expression.NAME.PARAMETER` …
    ///
    /// What follows from other parameters (the inverse inertia, what mixing leaves of itself) is not among them; call [`Drone::refresh`] after changing
    /// values.
    pub fn visit(&mut self, f: &mut dyn FnMut(&str, &mut S)) {
        self.body.visit("body", &mut |name, value| {
            if !name.starts_with("body.inertia_inverse.") {
                f(name, value);
            }
        });
        for i in 0..self.airframe.n_rotors {
            self.airframe.rotors[i].visit(&format!("rotors.{i}"), f);
        }
        if let Dynamics::AttitudeResponse(p) = &mut self.dynamics {
            p.visit("attitude_response", f);
        }
        self.controller.visit("controller", &mut |name, value| {
            if !name.starts_with("controller.mixer.beside.") {
                f(name, value);
            }
        });
        for effect in &mut self.effects {
            let prefix = format!("effect.{}", effect.label());
            effect.visit(&prefix, f);
        }
    }

    /// Recomputes derived parameters after changes.
    pub fn refresh(&mut self) {
        self.body.refresh();
        self.controller.mixer.refresh();
    }

    /// What the vehicle is built of where effects change it (payload, weak rotor …); `None` where none does.
    #[inline(always)]
    fn built(&self) -> Option<Parts<S>> {
        self.effects.iter().any(Effect::builds).then(|| self.parts())
    }

    /// What the vehicle is built of, with all effects.
    #[inline(always)]
    pub fn parts(&self) -> Parts<S> {
        let response = match &self.dynamics {
            Dynamics::Rotors => None,
            Dynamics::AttitudeResponse(p) => Some(*p),
        };
        let mut parts = Parts {
            body: self.body,
            airframe: self.airframe,
            response,
            thrust_point_m: [S::zero(); 3],
            thrust_factor: S::one(),
            thrust_bend: [S::zero(), S::one()],
        };
        for effect in &self.effects {
            effect.build(&mut parts);
        }
        parts
    }

    /// Rotor speed (rad/s) at which all rotors together carry the weight, each its equal share; where effects make rotors
    /// unequal, shares are those of the same speeds.
    pub fn hover_rotor_vel(&self) -> [S; MAX_ROTORS] {
        let n_rotors = self.airframe.n_rotors;
        let equal = self.hover_thrust() / S::lit(n_rotors.max(1) as f64);
        let mut out = [S::zero(); MAX_ROTORS];
        for i in 0..n_rotors {
            out[i] = rotor::speed_for_thrust(self.airframe.rotors[i].thrust_curve, equal);
        }
        let Some(parts) = self.built() else { return out };
        let given = airframe::loads(&parts.airframe, &out).thrust;
        let mut sum = S::zero();
        for i in 0..n_rotors {
            sum = sum + given[i];
        }
        let some = S::zero().lt(sum);
        let scale = self.hover_thrust() / S::select(some, sum, S::one());
        for i in 0..n_rotors {
            let share = S::select(some, scale * given[i], equal);
            out[i] = rotor::speed_for_thrust(parts.airframe.rotors[i].thrust_curve, share);
        }
        out
    }

    /// Weight with all that the vehicle carries, N.
    pub fn hover_thrust(&self) -> S {
        let body = self.built().map_or(self.body, |parts| parts.body);
        let mass_kg = self.effects.iter().fold(body.mass_kg, |sum, effect| sum + effect.carried_kg());
        mass_kg * vec3::norm(body.gravity_m_s2)
    }

    /// Collective thrust to command in the attitude modes so that it hovers, N: its weight, for the models that answer commands as they
    /// were fitted to flights through the gain and the offset of their thrust.
    pub fn hover_command(&self) -> S {
        match self.parts().response {
            None => self.hover_thrust(),
            Some(p) => (self.hover_thrust() - p.thrust_offset_n) / p.thrust_scale,
        }
    }

    /// Angular acceleration, rad/s², that the weight would give the body at the rotors' mean arm, about the mean of body x and y: how
    /// quickly a vehicle of this size turns: 116 rad/s² for an octocopter of 5 kg, 852 rad/s² for a quadrotor of 35 g.
    pub fn agility_rad_s2(&self) -> S {
        let inertia = self.body.inertia_kg_m2;
        self.hover_thrust() * self.mean_arm_m() * S::lit(2.0) / (inertia[0][0] + inertia[1][1])
    }

    /// Mean distance of the rotors from the body's z axis, m; zero where the file places none.
    pub fn mean_arm_m(&self) -> S {
        let rotors = self.airframe.n_rotors;
        let mut arms = S::zero();
        for i in 0..rotors {
            let [x, y, _] = self.airframe.rotors[i].position_m;
            arms = arms + (x.square() + y.square()).sqrt();
        }
        arms / S::lit(rotors.max(1) as f64)
    }

    /// Radius of the disc that has the area of all rotors, m.
    pub fn disc_radius_m(&self) -> S {
        let mut sum = S::zero();
        for i in 0..self.airframe.n_rotors {
            sum = sum + self.airframe.rotors[i].radius_m.square();
        }
        sum.sqrt()
    }

    /// Thrust gain of all effects for a rotor at `hub_m` (body).
    #[inline(always)]
    fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
        let mut gain = S::one();
        self.each(view, |effect, view| gain = gain * effect.thrust_gain(view, hub_m));
        gain
    }

    /// Every effect, with a view in which what it remembers stands.
    #[inline(always)]
    fn each(&self, view: &View<S>, mut act: impl FnMut(&AnyEffect<S>, &View<S>)) {
        let mut rest = view.surroundings.memory.numbers;
        for effect in &self.effects {
            // Most vehicles remember nothing.
            if rest.is_empty() {
                act(effect, view);
                continue;
            }
            let own = effect.memory_len(view.surroundings.memory.step_s).min(rest.len());
            let (memory, others) = rest.split_at(own);
            rest = others;
            act(effect, &View { memory, ..*view });
        }
    }

    /// Velocity of the air, m/s, world: that of the surroundings with what the effects add.
    #[inline(always)]
    fn air(&self, view: &View<S>) -> [S; 3] {
        let mut wind = view.surroundings.wind_m_s;
        self.each(view, |effect, view| wind = vec3::add(wind, effect.air(view)));
        wind
    }

    /// Thrust of the abstracted model under `command`, N; `None` for a vehicle whose state has rotor speeds.
    #[inline(always)]
    fn collective_n(&self, built: Option<&Parts<S>>, state: &State<S>, command: &Command<S>) -> Option<S> {
        match (&self.dynamics, command) {
            (Dynamics::AttitudeResponse(filed), Command::Attitude(c)) => {
                let p = built.and_then(|parts| parts.response.as_ref()).unwrap_or(filed);
                Some(attitude_response::thrust(p, state.thrust, c[3]))
            }
            _ => None,
        }
    }

    /// Velocity of the air at the vehicle, m/s, world: that of the surroundings with what the effects add (wind,
    /// gusts).
    pub fn wind_m_s(&self, state: &State<S>, command: &Command<S>, surroundings: &Surroundings<S>) -> [S; 3] {
        let built = self.built();
        let (body, airframe) =
            built.as_ref().map_or((&self.body, &self.airframe), |parts| (&parts.body, &parts.airframe));
        let collective_n = self.collective_n(built.as_ref(), state, command);
        self.air(&View { body, airframe, state, surroundings, collective_n, memory: &[] })
    }

    /// Voltage of the battery under the load of this step, V; `None` without a battery among the effects. Arguments as
    /// in [`Drone::transmit`], of which this is the part up to the battery; `command` and `memory` are left as there, so
    /// hand in copies.
    pub fn battery_v(
        &self,
        state: &State<S>,
        surroundings: &Surroundings<S>,
        dt_s: (S, f64),
        command: &mut Command<S>,
        memory: &mut [S],
    ) -> Option<S> {
        let built = self.built();
        let (body, airframe) =
            built.as_ref().map_or((&self.body, &self.airframe), |parts| (&parts.body, &parts.airframe));
        let collective_n = self.collective_n(built.as_ref(), state, command);
        let view = View { body, airframe, state, surroundings, collective_n, memory: &[] };
        let mut rest = memory;
        for effect in &self.effects {
            let (mine, others) = rest.split_at_mut(effect.memory_len(dt_s.1));
            let battery_v = effect.battery_v(&view, command, mine);
            if battery_v.is_some() {
                return battery_v;
            }
            if !effect.controls() {
                effect.command(&view, dt_s.0, command, mine);
            }
            rest = others;
        }
        None
    }

    /// Time derivative of `state` under `command`.
    #[inline(always)]
    pub fn rate(&self, state: &State<S>, command: &Command<S>, surroundings: &Surroundings<S>) -> Rate<S> {
        if self.effects.iter().any(Effect::builds) {
            return self.rate_as_built(state, command, surroundings);
        }
        let response = match &self.dynamics {
            Dynamics::Rotors => None,
            Dynamics::AttitudeResponse(p) => Some(p),
        };
        let of = (&self.body, &self.airframe, response);
        self.rate_of(of, None, state, &Drive::Command(command), surroundings)
    }

    /// [`Drone::rate`] where effects change what the vehicle is built of; apart, so that the others stay fast.
    #[inline(never)]
    fn rate_as_built(
        &self,
        state: &State<S>,
        command: &Command<S>,
        surroundings: &Surroundings<S>,
    ) -> Rate<S> {
        let parts = self.parts();
        let of = (&parts.body, &parts.airframe, parts.response.as_ref());
        self.rate_of(of, Some(&parts), state, &Drive::Command(command), surroundings)
    }

    /// Time derivative of `state` where not a command but a measurement drives the vehicle: rotors that turn as
    /// `state.rotor_vel` says and speed up as given, or a known collective thrust.
    ///
    /// A known thrust acts along body z at the centre of mass and leaves the angular acceleration without the rotors'
    /// torque, which is unknown then.
    pub fn rate_measured(
        &self,
        state: &State<S>,
        measured: &Measured<S>,
        surroundings: &Surroundings<S>,
    ) -> Rate<S> {
        self.rate_measured_of(&self.parts(), state, measured, surroundings)
    }

    /// [`Drone::rate_measured`] with [`Drone::parts`] computed before.
    #[inline(never)]
    pub fn rate_measured_of(
        &self,
        parts: &Parts<S>,
        state: &State<S>,
        measured: &Measured<S>,
        surroundings: &Surroundings<S>,
    ) -> Rate<S> {
        let of = (&parts.body, &parts.airframe, parts.response.as_ref());
        let drive = match measured {
            Measured::RotorAcc(acc) => Drive::RotorAcc(acc),
            Measured::Thrust(thrust) => Drive::Thrust(*thrust),
        };
        self.rate_of(of, Some(parts), state, &drive, surroundings)
    }

    /// What the vehicle's sensors read.
    #[inline(always)]
    pub fn read(&self, state: &State<S>, rate: &Rate<S>) -> Reading<S> {
        let mut reading = Reading::ideal(state, rate, self.body.gravity_m_s2);
        for effect in &self.effects {
            effect.measure(&mut reading);
        }
        reading
    }

    /// How late the sensors' clocks are.
    pub fn clock(&self) -> Clock<S> {
        self.effects.iter().fold(Clock::zero(), |clock, effect| clock.plus(effect.clock()))
    }

    /// [`Drone::rate`] of a vehicle of these parts; `built` where effects changed them.
    #[inline(always)]
    fn rate_of(
        &self,
        (body, airframe, response): (
            &rigid_body::Params<S>,
            &airframe::Params<S>,
            Option<&attitude_response::Params<S>>,
        ),
        built: Option<&Parts<S>>,
        state: &State<S>,
        drive: &Drive<S>,
        surroundings: &Surroundings<S>,
    ) -> Rate<S> {
        let collective_n = drive.collective_n(response, state);
        let mut surroundings = *surroundings;
        surroundings.wind_m_s =
            self.air(&View { body, airframe, state, surroundings: &surroundings, collective_n, memory: &[] });
        let view = View { body, airframe, state, surroundings: &surroundings, collective_n, memory: &[] };

        let mut outer = Wrench {
            force: surroundings.disturbance_force_n,
            body_force: [S::zero(); 3],
            torque: quat::rotate_inverse(state.quat, surroundings.disturbance_torque_n_m),
        };
        self.each(&view, |effect, view| effect.wrench(view, &mut outer));

        let zero = S::zero();
        let mut rotor_acc = [zero; MAX_ROTORS];
        let mut thrust_rate = zero;
        let mut turned = false;
        match (response, drive) {
            (None, Drive::Command(Command::Rotors(speeds))) => {
                for i in 0..airframe.n_rotors {
                    rotor_acc[i] = rotor::acceleration(&airframe.rotors[i], state.rotor_vel[i], speeds[i]);
                }
                turned = true;
            }
            (_, Drive::RotorAcc(given)) => {
                rotor_acc = **given;
                turned = true;
            }
            _ => {}
        }
        let (acc, ang_acc) = match (response, drive) {
            _ if turned => {
                let mut loads = airframe::loads(airframe, &state.rotor_vel);
                for i in 0..airframe.n_rotors {
                    loads.thrust[i] =
                        loads.thrust[i] * self.thrust_gain(&view, airframe.rotors[i].position_m);
                }
                let (force, torque) =
                    airframe::wrench(airframe, &loads, &state.rotor_vel, &rotor_acc, state.ang_vel);
                outer.add_body_force(force);
                outer.torque = vec3::add(outer.torque, torque);
                rigid_body::accelerations(body, state.quat, state.ang_vel, &outer)
            }
            (Some(p), Drive::Command(Command::Attitude(c))) => {
                thrust_rate = attitude_response::thrust_rate(p, state.thrust, c[3]);
                let thrust =
                    attitude_response::thrust(p, state.thrust, c[3]) * self.thrust_gain(&view, [zero; 3]);
                if let Some(parts) = built {
                    let torque = vec3::cross(parts.thrust_point_m, [zero, zero, thrust]);
                    outer.torque = vec3::add(outer.torque, torque);
                }
                attitude_response::accelerations(p, body, state, *c, thrust, &outer)
            }
            (_, Drive::Thrust(thrust)) => {
                let thrust = built.map_or(*thrust, |parts| parts.true_thrust(*thrust));
                let thrust = airframe::collective(airframe, thrust * self.thrust_gain(&view, [zero; 3]));
                outer.add_body_force(thrust);
                rigid_body::accelerations(body, state.quat, state.ang_vel, &outer)
            }
            // A command of the other kind drives nothing; `rollout` never mixes them.
            _ => rigid_body::accelerations(body, state.quat, state.ang_vel, &outer),
        };
        Rate { vel: state.vel, ang_vel: state.ang_vel, acc, ang_acc, rotor_acc, thrust_rate }
    }

    /// What some effect reads of the surroundings: what a simulation must fill in before this vehicle flies in it.
    pub fn reads(&self) -> Reads {
        self.effects.iter().fold(Reads::NOTHING, |reads, effect| reads.or(effect.reads()))
    }

    /// Numbers of memory that all effects keep between steps of `dt_s` seconds.
    pub fn memory_len(&self, dt_s: f64) -> usize {
        self.effects.iter().map(|e| e.memory_len(dt_s)).sum()
    }

    /// Lets every effect fill its memory (zero until then) at a reset that starts with `command` in force;
    /// `memory_len` gives [`Effect::memory_len`] at the simulation's steps.
    pub fn start(&self, command: &Command<S>, memory_len: impl Fn(&AnyEffect<S>) -> usize, memory: &mut [S]) {
        let mut rest = memory;
        for effect in &self.effects {
            let (mine, others) = rest.split_at_mut(memory_len(effect));
            effect.start(command, mine);
            rest = others;
        }
    }

    /// Whether an effect takes the place of the on-board controller ([`Effect::controls`]).
    pub fn controls_itself(&self) -> bool {
        self.effects.iter().any(Effect::controls)
    }

    /// The command of the effect that takes the place of the on-board controller, if there is one, once per step of `dt_s` seconds; `memory` has
    /// [`Drone::memory_len`] numbers. It sees the wind of the surroundings without what effects add, and the vehicle as filed.
    pub fn own_command(
        &self,
        state: &State<S>,
        surroundings: &Surroundings<S>,
        dt_s: (S, f64),
        memory: &mut [S],
    ) -> Option<Command<S>> {
        let mut rest = memory;
        for effect in &self.effects {
            let (mine, others) = rest.split_at_mut(effect.memory_len(dt_s.1));
            if effect.controls() {
                let (body, airframe, zero) = (&self.body, &self.airframe, S::zero());
                let mut command = match self.dynamics {
                    Dynamics::Rotors => Command::Rotors([zero; MAX_ROTORS]),
                    Dynamics::AttitudeResponse(_) => Command::Attitude([zero; 4]),
                };
                let view = View { body, airframe, state, surroundings, collective_n: None, memory: &[] };
                effect.command(&view, dt_s.0, &mut command, mine);
                return Some(command);
            }
            rest = others;
        }
        None
    }

    /// Lets every effect change the command, and then add to the surroundings, once per step of `dt_s` seconds; `memory`
    /// has [`Drone::memory_len`] numbers.
    #[inline(always)]
    pub fn transmit(
        &self,
        state: &State<S>,
        surroundings: &mut Surroundings<S>,
        dt_s: (S, f64),
        command: &mut Command<S>,
        memory: &mut [S],
    ) {
        let built = self.built();
        self.transmit_as_built(built.as_ref(), state, surroundings, dt_s, command, memory);
    }

    /// [`Drone::transmit`] of a vehicle of these parts; `built` where effects changed them.
    #[inline(always)]
    pub fn transmit_as_built(
        &self,
        built: Option<&Parts<S>>,
        state: &State<S>,
        surroundings: &mut Surroundings<S>,
        dt_s: (S, f64),
        command: &mut Command<S>,
        memory: &mut [S],
    ) {
        let (body, airframe) = match built {
            Some(parts) => (&parts.body, &parts.airframe),
            None => (&self.body, &self.airframe),
        };
        let collective_n = self.collective_n(built, state, command);
        let mut windy = *surroundings;
        for effect in &self.effects {
            let view = View { body, airframe, state, surroundings, collective_n, memory: &[] };
            windy.wind_m_s = vec3::add(windy.wind_m_s, effect.air(&view));
        }
        let view = View { body, airframe, state, surroundings: &windy, collective_n, memory: &[] };
        let mut rest = &mut *memory;
        for effect in &self.effects {
            // Most vehicles remember nothing.
            let own = if rest.is_empty() { 0 } else { effect.memory_len(dt_s.1) };
            let (mine, others) = rest.split_at_mut(own);
            // A controller has run already.
            if !effect.controls() {
                effect.command(&view, dt_s.0, command, mine);
            }
            rest = others;
        }
        self.recall(memory, dt_s.1, surroundings);
    }

    /// Lets every effect add to the surroundings what it remembers; `memory` has [`Drone::memory_len`] numbers of steps of
    /// `dt_s` seconds.
    #[inline(always)]
    pub fn recall(&self, memory: &[S], dt_s: f64, surroundings: &mut Surroundings<S>) {
        let mut rest = memory;
        for effect in &self.effects {
            let own = if rest.is_empty() { 0 } else { effect.memory_len(dt_s) };
            let (mine, others) = rest.split_at(own);
            effect.surround(mine, surroundings);
            rest = others;
        }
    }
}
