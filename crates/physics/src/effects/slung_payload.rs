//! A point mass on a massless, inextensible, always taut cable: a spherical pendulum that pulls at the vehicle.
//!
//! With the unit vector n from the attachment to the load, its rate ṅ, cable length l and the attachment's acceleration a:
//! l n̈ = (g − a) − ((g − a)·n) n − l |ṅ|² n − c l ṅ, and the load accelerates with a_l = a + l n̈. Newton's law on the load gives
//! the force on the vehicle, F = m_l (g − a_l) = m_l ((g − a)·n + l |ṅ|²) n + m_l c l ṅ.
//! Source: Sreenath, Lee & Kumar, "Geometric control and differential flatness of a quadrotor UAV with a cable-suspended
//! load", IEEE CDC 2013, § II; the damping c is ours.
//!
//! In simulation the pendulum follows the attachment's true motion: over each step its mean acceleration is the change of
//! its velocity. The force for the next step needs an acceleration that itself depends on the force. The part of the last
//! acceleration that was not the cable's doing is kept, and the equation is solved for the force with the attachment's
//! mobility β = n·(M⁻¹ n) (added mass along the cable): F·n = m_l (…)/(1 + m_l β). So nothing feeds back from step to step at any
//! mass of the load; what is left is that the other forces count with one step's delay.

use super::{Command, Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, FromLog, Nature, Needs, along};
use crate::params::parameters;
use crate::rigid_body::{self, State, Wrench};
use crate::surroundings::{Load, Surroundings};
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of the load and its cable.
    pub struct Params {
        /// Mass m_l of the load, kg.
        mass_kg: S,
        /// Length l of the cable, m.
        cable_length_m: S,
        /// Where the cable is attached, m from the centre of mass, body.
        attachment_m: [S; 3],
        /// Damping c of the swing, 1/s: deceleration per velocity relative to the attachment.
        damping_per_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { mass_kg: 0.0, cable_length_m: 0.5, attachment_m: [0.0; 3], damping_per_s: 0.0 }
    }
}

/// Where the load hangs, seen from the attachment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pendulum<S> {
    /// Unit vector from the attachment to the load, world.
    pub direction: [S; 3],
    /// Its rate of change, 1/s, perpendicular to it.
    pub rate_per_s: [S; 3],
}

/// Motion of the attachment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pivot<S> {
    /// Position, m, world.
    pub position_m: [S; 3],
    /// Velocity, m/s, world.
    pub velocity_m_s: [S; 3],
    /// Acceleration, m/s², world.
    pub acceleration_m_s2: [S; 3],
}

impl<S: Real> Pendulum<S> {
    /// At rest along gravity (straight down where there is none).
    pub fn hanging(gravity_m_s2: [S; 3]) -> Self {
        let (zero, one) = (S::zero(), S::one());
        let direction = vec3::normalize_or(gravity_m_s2, [zero, zero, -one]);
        Self { direction, rate_per_s: [zero; 3] }
    }

    /// With a load seen at `position_m`, moving with `velocity_m_s` (world), on a cable from `pivot`. Only the part of the
    /// velocity across the cable counts; where the load is at the attachment, it is taken to hang below.
    pub fn seen(position_m: [S; 3], velocity_m_s: [S; 3], pivot: &Pivot<S>) -> Self {
        let (zero, one) = (S::zero(), S::one());
        let cable = vec3::sub(position_m, pivot.position_m);
        let length = vec3::norm(cable);
        let direction = vec3::normalize_or(cable, [zero, zero, -one]);
        let inverse = one / S::select(zero.lt(length), length, one);
        let rate = vec3::scale(vec3::sub(velocity_m_s, pivot.velocity_m_s), inverse);
        Self { direction, rate_per_s: across(rate, direction) }
    }
}

/// The part of `v` that is perpendicular to the unit vector `n`.
#[inline(always)]
fn across<S: Real>(v: [S; 3], n: [S; 3]) -> [S; 3] {
    vec3::sub(v, vec3::scale(n, vec3::dot(v, n)))
}

impl<S: Real> Params<S> {
    /// Motion of the attachment of a vehicle that moves as `state` and accelerates with `acc` (m/s², world) and `ang_acc`
    /// (rad/s², body).
    #[inline(always)]
    pub fn pivot(&self, state: &State<S>, acc: [S; 3], ang_acc: [S; 3]) -> Pivot<S> {
        let r = self.attachment_m;
        let spin = vec3::cross(state.ang_vel, r);
        let turning = vec3::add(vec3::cross(ang_acc, r), vec3::cross(state.ang_vel, spin));
        Pivot {
            position_m: vec3::add(state.pos, quat::rotate(state.quat, r)),
            velocity_m_s: vec3::add(state.vel, quat::rotate(state.quat, spin)),
            acceleration_m_s2: vec3::add(acc, quat::rotate(state.quat, turning)),
        }
    }

    /// Second derivative of the direction, 1/s², for the acceleration of the attachment.
    #[inline(always)]
    fn swing(&self, pendulum: &Pendulum<S>, acc: [S; 3], gravity: [S; 3]) -> [S; 3] {
        let (n, w) = (pendulum.direction, pendulum.rate_per_s);
        let drive = vec3::scale(across(vec3::sub(gravity, acc), n), S::one() / self.cable_length_m);
        let inward = vec3::scale(n, vec3::dot(w, w));
        vec3::sub(vec3::sub(drive, inward), vec3::scale(w, self.damping_per_s))
    }

    /// The pendulum after `dt_s` seconds in which the attachment accelerates with `pivot_acc_m_s2` (m/s², world): one step of
    /// Runge–Kutta of order four, after which the direction has unit length and the rate is perpendicular to it.
    #[inline(always)]
    pub fn advance(
        &self,
        pendulum: &Pendulum<S>,
        pivot_acc_m_s2: [S; 3],
        gravity_m_s2: [S; 3],
        dt_s: S,
    ) -> Pendulum<S> {
        let slope = |p: &Pendulum<S>| (p.rate_per_s, self.swing(p, pivot_acc_m_s2, gravity_m_s2));
        let moved = |k: &([S; 3], [S; 3]), h: S| Pendulum {
            direction: vec3::add(pendulum.direction, vec3::scale(k.0, h)),
            rate_per_s: vec3::add(pendulum.rate_per_s, vec3::scale(k.1, h)),
        };
        let half = S::lit(0.5) * dt_s;
        let k1 = slope(pendulum);
        let k2 = slope(&moved(&k1, half));
        let k3 = slope(&moved(&k2, half));
        let k4 = slope(&moved(&k3, dt_s));
        let mean = |a: [S; 3], b: [S; 3], c: [S; 3], d: [S; 3]| {
            vec3::scale(
                vec3::add(vec3::add(a, d), vec3::scale(vec3::add(b, c), S::lit(2.0))),
                S::lit(1.0 / 6.0),
            )
        };
        let end = moved(&(mean(k1.0, k2.0, k3.0, k4.0), mean(k1.1, k2.1, k3.1, k4.1)), dt_s);
        let direction = vec3::normalize_or(end.direction, pendulum.direction);
        Pendulum { direction, rate_per_s: across(end.rate_per_s, direction) }
    }

    /// Motion of a load that hangs like this from an attachment that moves like `pivot`: what [`Surroundings::load`] takes
    /// where the load itself is not measured, or only where it hangs.
    #[inline(always)]
    pub fn load(&self, pendulum: &Pendulum<S>, pivot: &Pivot<S>, gravity_m_s2: [S; 3]) -> Load<S> {
        let length = self.cable_length_m;
        let swing = self.swing(pendulum, pivot.acceleration_m_s2, gravity_m_s2);
        Load {
            position_m: vec3::add(pivot.position_m, vec3::scale(pendulum.direction, length)),
            velocity_m_s: vec3::add(pivot.velocity_m_s, vec3::scale(pendulum.rate_per_s, length)),
            acceleration_m_s2: vec3::add(pivot.acceleration_m_s2, vec3::scale(swing, length)),
            present: S::one(),
        }
    }

    /// Acceleration of the attachment by a force of 1 N at it, for `force` (N) in world axes, of a vehicle with this body.
    #[inline(always)]
    fn mobility(&self, body: &rigid_body::Params<S>, q: [S; 4], force: [S; 3]) -> [S; 3] {
        let torque = vec3::cross(self.attachment_m, quat::rotate_inverse(q, force));
        let turning = vec3::cross(vec3::mat_vec(body.inertia_inverse, torque), self.attachment_m);
        vec3::add(vec3::scale(force, S::one() / body.mass_kg), quat::rotate(q, turning))
    }
}

/// What the effect remembers between steps.
struct Memory<S> {
    pendulum: Pendulum<S>,
    /// Velocity of the attachment at the last step.
    pivot_velocity: [S; 3],
    load: Load<S>,
}

impl<S: Real> Memory<S> {
    const LEN: usize = 19;

    fn load(memory: &[S]) -> Self {
        let three = |i: usize| [memory[i], memory[i + 1], memory[i + 2]];
        Self {
            pendulum: Pendulum { direction: three(0), rate_per_s: three(3) },
            pivot_velocity: three(6),
            load: Load {
                position_m: three(9),
                velocity_m_s: three(12),
                acceleration_m_s2: three(15),
                present: memory[18],
            },
        }
    }

    fn store(&self, memory: &mut [S]) {
        let load = &self.load;
        let lists = [
            self.pendulum.direction,
            self.pendulum.rate_per_s,
            self.pivot_velocity,
            load.position_m,
            load.velocity_m_s,
            load.acceleration_m_s2,
        ];
        for (slot, list) in memory.chunks_exact_mut(3).zip(&lists) {
            slot.copy_from_slice(list);
        }
        memory[Self::LEN - 1] = load.present;
    }
}

/// `yes` where `mask` holds, else `no`.
#[inline(always)]
fn choose<S: Real>(mask: S::Mask, yes: [S; 3], no: [S; 3]) -> [S; 3] {
    [S::select(mask, yes[0], no[0]), S::select(mask, yes[1], no[1]), S::select(mask, yes[2], no[2])]
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { only_when_found: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const {
            &[
                ("mass_kg", Bounds::from(0.0)),
                ("cable_length_m", Bounds::above(0.0)),
                ("damping_per_s", Bounds::from(0.0)),
            ]
        }
    }

    fn carried_kg(&self) -> S {
        self.mass_kg
    }

    fn memory_len(&self, _: f64) -> usize {
        Memory::<S>::LEN
    }

    /// Moves the pendulum along with the attachment's motion since the last step, and predicts its pull for this one. At the
    /// first step after a reset the load hangs still.
    fn command(&self, view: &View<S>, dt_s: S, _: &mut Command<S>, memory: &mut [S]) {
        let (state, gravity, zero) = (view.state, view.body.gravity_m_s2, S::zero());
        let last = Memory::load(memory);
        let begun = zero.lt(last.load.present);
        let now = self.pivot(state, [zero; 3], [zero; 3]);
        let change = vec3::sub(now.velocity_m_s, last.pivot_velocity);
        let acc = choose::<S>(begun, vec3::scale(change, S::one() / dt_s), [zero; 3]);
        let pull = choose::<S>(begun, vec3::sub(gravity, last.load.acceleration_m_s2), gravity);

        let hanging = Pendulum::hanging(gravity);
        let moved = self.advance(&last.pendulum, acc, gravity, dt_s);
        let pendulum = Pendulum {
            direction: choose::<S>(begun, moved.direction, hanging.direction),
            rate_per_s: choose::<S>(begun, moved.rate_per_s, hanging.rate_per_s),
        };
        let (n, w) = (pendulum.direction, pendulum.rate_per_s);

        // The attachment's acceleration without the cable, and along it the tension per kilogram of load.
        let by_cable = self.mobility(view.body, state.quat, vec3::scale(pull, self.mass_kg));
        let free = vec3::sub(acc, by_cable);
        let drag = vec3::scale(w, self.damping_per_s * self.cable_length_m);
        let by_drag = self.mobility(view.body, state.quat, vec3::scale(drag, self.mass_kg));
        let without = vec3::sub(gravity, vec3::add(free, by_drag));
        let along = vec3::dot(without, n) + self.cable_length_m * vec3::dot(w, w);
        let beta = vec3::dot(n, self.mobility(view.body, state.quat, n));
        let tension = along / (S::one() + self.mass_kg * beta);

        let reach = vec3::scale(n, self.cable_length_m);
        let load = Load {
            position_m: vec3::add(now.position_m, reach),
            velocity_m_s: vec3::add(now.velocity_m_s, vec3::scale(w, self.cable_length_m)),
            acceleration_m_s2: vec3::sub(gravity, vec3::add(vec3::scale(n, tension), drag)),
            present: S::one(),
        };
        Memory { pendulum, pivot_velocity: now.velocity_m_s, load }.store(memory);
    }

    fn surround(&self, memory: &[S], surroundings: &mut Surroundings<S>) {
        let own = Memory::load(memory).load;
        let given = surroundings.load;
        let measured = S::zero().lt(given.present);
        surroundings.load = Load {
            position_m: choose::<S>(measured, given.position_m, own.position_m),
            velocity_m_s: choose::<S>(measured, given.velocity_m_s, own.velocity_m_s),
            acceleration_m_s2: choose::<S>(measured, given.acceleration_m_s2, own.acceleration_m_s2),
            present: S::select(measured, given.present, own.present),
        };
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let load = &view.surroundings.load;
        let pull = vec3::sub(view.body.gravity_m_s2, load.acceleration_m_s2);
        let force = vec3::scale(pull, self.mass_kg * load.present);
        out.force = vec3::add(out.force, force);
        let body = quat::rotate_inverse(view.state.quat, force);
        out.torque = vec3::add(out.torque, vec3::cross(self.attachment_m, body));
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // Loads of 5 to 20 % of the mass are what small vehicles carry.
    let mut freedoms = vec![Freedom::up("mass_kg", "kg", 0.0, 0.08 * drone.body.mass_kg)];
    // Where the cable is attached shows in torques alone.
    freedoms.extend(along("attachment_m", 0..3, "m", (0.0, 0.03)).into_iter().map(Freedom::in_torques));
    vec![
        Candidate::new(
            "slung_payload",
            "a load that swings below the vehicle on a cable",
            Area::Mass,
            freedoms,
            "hover, then fly fast back and forth with stops of a few seconds, so that the load swings",
        )
        // How the load moves is known before a fit: a load that nobody saw swings as it likes.
        .needing(Needs::Load)
        .preset("cable_length_m", 0.5)
        .given_by("cable_length_m", FromLog::CableLength)
        .given_by("damping_per_s", FromLog::CableDamping),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::integrate::Integrator;
    use crate::params::Parameters;
    use crate::rigid_body::MAX_ROTORS;
    use crate::sample::quad;
    use core::f64::consts::TAU;
    use propwash_trace::dual::Dual;

    const G: [f64; 3] = [0.0, 0.0, -9.81];

    fn load_of(mass_kg: f64, cable_length_m: f64) -> Params<f64> {
        Params { mass_kg, cable_length_m, ..Params::default() }
    }

    fn tilted(angle: f64) -> Pendulum<f64> {
        Pendulum { direction: [angle.sin(), 0.0, -angle.cos()], rate_per_s: [0.0; 3] }
    }

    #[test]
    fn a_still_attachment_gives_the_period_of_a_pendulum_and_keeps_its_energy() {
        let p = load_of(0.1, 0.7);
        let (mut pendulum, dt) = (tilted(0.01), 0.002);
        let energy = |q: &Pendulum<f64>| {
            0.5 * (0.7 * vec3::norm(q.rate_per_s)).powi(2) + 9.81 * 0.7 * (1.0 + q.direction[2])
        };
        let start = energy(&pendulum);
        let (mut crossings, mut last) = (Vec::new(), pendulum.direction[0]);
        for step in 1..20_000 {
            pendulum = p.advance(&pendulum, [0.0; 3], G, dt);
            let x = pendulum.direction[0];
            if last > 0.0 && x <= 0.0 {
                crossings.push(dt * (f64::from(step) - x / (x - last)));
            }
            last = x;
        }
        let period = (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64;
        let expected = TAU * (0.7f64 / 9.81).sqrt();
        // Amplitude θ lengthens the period by θ²/16.
        assert!((period / expected - 1.0 - 0.01f64.powi(2) / 16.0).abs() < 1e-7, "{period} {expected}");
        assert!((energy(&pendulum) / start - 1.0).abs() < 1e-6);
        assert!((vec3::norm(pendulum.direction) - 1.0).abs() < 1e-12);
        // Swinging wide and around, the energy stays as well.
        let mut wide = Pendulum { direction: [0.8, 0.0, -0.6], rate_per_s: [0.0, 2.0, 0.0] };
        let start = energy(&wide);
        for _ in 0..5000 {
            wide = p.advance(&wide, [0.0; 3], G, dt);
        }
        assert!((energy(&wide) / start - 1.0).abs() < 1e-6, "{}", energy(&wide) / start);
    }

    #[test]
    fn damping_takes_the_swing_away_at_half_its_rate() {
        let p = Params { damping_per_s: 0.6, ..load_of(0.1, 0.5) };
        let mut pendulum = tilted(0.01);
        let amplitude = |q: &Pendulum<f64>| {
            // x² + ((ẋ + c/2 x)/ω_d)² of a damped oscillation falls with e^(−c t).
            let (x, v) = (q.direction[0], q.rate_per_s[0]);
            let damped = (9.81 / 0.5 - 0.09f64).sqrt();
            (x * x + ((v + 0.3 * x) / damped).powi(2)).sqrt()
        };
        let start = amplitude(&pendulum);
        for _ in 0..2000 {
            pendulum = p.advance(&pendulum, [0.0; 3], G, 0.002);
        }
        assert!((amplitude(&pendulum) / start / (-0.3 * 4.0f64).exp() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn an_accelerated_attachment_drags_the_load_behind_it_at_the_angle_of_apparent_gravity() {
        let p = Params { damping_per_s: 3.0, ..load_of(0.1, 0.5) };
        let mut pendulum = Pendulum::hanging(G);
        for _ in 0..5000 {
            pendulum = p.advance(&pendulum, [4.0, 0.0, 0.0], G, 0.002);
        }
        let n = pendulum.direction;
        assert!((n[0] / n[2] - 4.0 / 9.81).abs() < 1e-6 && n[0] < 0.0, "{n:?}");
        // Then the load accelerates as the attachment does, and pulls with its apparent weight.
        let pivot =
            Pivot { position_m: [0.0; 3], velocity_m_s: [0.0; 3], acceleration_m_s2: [4.0, 0.0, 0.0] };
        let load = p.load(&pendulum, &pivot, G);
        assert!((load.acceleration_m_s2[0] - 4.0).abs() < 1e-4 && load.acceleration_m_s2[2].abs() < 1e-4);
    }

    /// A vehicle whose attitude is level and whose rotors carry vehicle and load, flown by the hooks as a simulation does.
    struct Flight {
        drone: Drone<f64>,
        state: State<f64>,
        memory: Vec<f64>,
        integrator: Integrator,
    }

    const DT: f64 = 0.002;

    impl Flight {
        fn new(load: Params<f64>, swing: Pendulum<f64>) -> Self {
            let drone = quad(vec![AnyEffect::SlungPayload(load)]);
            let mut memory = vec![0.0; drone.memory_len(DT)];
            let start =
                Pivot { position_m: load.attachment_m, velocity_m_s: [0.0; 3], acceleration_m_s2: [0.0; 3] };
            let load = load.load(&swing, &start, G);
            Memory { pendulum: swing, pivot_velocity: [0.0; 3], load }.store(&mut memory);
            let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
            Self { drone, state, memory, integrator: Integrator::Euler }
        }

        fn step(&mut self, rotors: [f64; MAX_ROTORS]) -> Load<f64> {
            let mut command = Command::Rotors(rotors);
            let mut around = Surroundings::calm();
            self.drone.transmit(&self.state, &mut around, (DT, DT), &mut command, &mut self.memory);
            let drone = &self.drone;
            self.state = self.integrator.step(&self.state, DT, |s| drone.rate(s, &command, &around));
            around.load
        }
    }

    #[test]
    fn thrust_of_both_weights_holds_vehicle_and_load() {
        for integrator in [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4] {
            let mut flight = Flight::new(load_of(0.2, 0.6), Pendulum::hanging(G));
            flight.integrator = integrator;
            flight.memory.fill(0.0);
            assert!((flight.drone.hover_thrust() - 1.2 * 9.81).abs() < 1e-12);
            let rotors = flight.drone.hover_rotor_vel();
            for _ in 0..1000 {
                let load = flight.step(rotors);
                assert!((load.position_m[2] + 0.6).abs() < 1e-9, "{load:?}");
            }
            assert!(vec3::norm(flight.state.vel) < 1e-9, "{:?}", flight.state.vel);
        }
    }

    #[test]
    fn a_free_vehicle_and_its_load_swing_about_their_common_centre_of_mass() {
        // Level, thrust (m + m_l) g: m ẍ = m_l g θ, l θ̈ = −g θ − ẍ, hence ω² = g/l (1 + m_l/m).
        for (mass, length) in [(0.05, 0.4), (0.2, 0.4), (0.2, 1.0)] {
            let mut flight = Flight::new(load_of(mass, length), tilted(0.01));
            let rotors = flight.drone.hover_rotor_vel();
            let (mut crossings, mut last) = (Vec::new(), 1.0);
            for step in 0..10_000 {
                let at = f64::from(step) * DT;
                let load = flight.step(rotors);
                // The vehicle has moved on by one step; the load's place is that of the step's beginning.
                let x = Memory::load(&flight.memory).pendulum.direction[0];
                assert!(load.present == 1.0);
                if last > 0.0 && x <= 0.0 {
                    crossings.push(at - DT * x / (x - last));
                }
                last = x;
            }
            let period = (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64;
            let expected = TAU / (9.81 / length * (1.0 + mass)).sqrt();
            assert!((period / expected - 1.0).abs() < 1e-4, "{mass} {length}: {period} {expected}");
        }
    }

    /// Momentum of vehicle and load at the beginning of a step.
    fn momentum(vehicle: [f64; 3], load: &Load<f64>, mass: f64) -> [f64; 3] {
        vec3::add(vehicle, vec3::scale(load.velocity_m_s, mass))
    }

    #[test]
    fn the_pair_gains_only_the_momentum_that_thrust_and_weight_give_it() {
        for integrator in [Integrator::Euler, Integrator::Rk4] {
            // A wide swing at a fifth of the mass, thrust on and off in jumps.
            let mut flight = Flight::new(load_of(0.2, 0.5), tilted(0.8));
            flight.integrator = integrator;
            let hover = flight.drone.hover_rotor_vel();
            let (mut given, mut worst) = ([0.0f64; 3], 0.0f64);
            for step in 0..5000 {
                let before = flight.state;
                assert!((before.quat[3] - 1.0).abs() < 1e-12, "level without torque");
                let rotors = hover.map(|v| v * if step / 250 % 2 == 0 { 1.2 } else { 0.8 });
                let load = flight.step(rotors);
                let found = momentum(before.vel, &load, 0.2);
                worst = worst.max(vec3::norm(vec3::sub(found, given)));
                // Thrust over the step: what the vehicle gained beyond weight and cable.
                let cable = vec3::scale(vec3::sub(G, load.acceleration_m_s2), 0.2);
                let gained = vec3::sub(flight.state.vel, before.vel);
                for i in 0..3 {
                    given[i] += gained[i] - DT * cable[i] - DT * G[i] + DT * 1.2 * G[i];
                }
            }
            // One step's delay of the thrust: about m_l Δa dt at a jump. Nothing adds up over 10 s.
            assert!(worst < 0.006, "{worst} kg m/s by {integrator:?}");
        }
    }

    #[test]
    fn the_pull_at_an_attachment_below_the_centre_of_mass_tilts_the_vehicle_and_stays_stable() {
        let load = Params { attachment_m: [0.02, 0.0, -0.05], ..load_of(0.2, 0.5) };
        let mut flight = Flight::new(load, Pendulum::hanging(G));
        let rotors = flight.drone.hover_rotor_vel();
        flight.step(rotors);
        // 0.2 g at 0.02 m ahead turns the nose down; the inertia is 0.01 kg m².
        let expected = 0.2 * 9.81 * 0.02 / 0.01 * DT;
        assert!((flight.state.ang_vel[1] - expected).abs() < 1e-9, "{:?}", flight.state.ang_vel);
        for _ in 0..250 {
            let load = flight.step(rotors);
            let pull = vec3::norm(vec3::sub(G, load.acceleration_m_s2));
            assert!(pull > 2.0 && pull < 40.0, "{pull}");
        }
    }

    #[test]
    fn a_heavier_load_than_the_vehicle_stays_stable_too() {
        let mut flight = Flight::new(load_of(3.0, 0.5), tilted(0.5));
        let rotors = flight.drone.hover_rotor_vel();
        for _ in 0..5000 {
            let load = flight.step(rotors);
            assert!(vec3::norm(load.acceleration_m_s2) < 40.0, "{load:?}");
        }
    }

    #[test]
    fn a_measured_load_goes_before_the_pendulum_and_pulls_by_its_own_acceleration() {
        let drone = quad(vec![AnyEffect::SlungPayload(load_of(0.2, 0.5))]);
        let measured = Load {
            position_m: [0.1, 0.0, -0.49],
            velocity_m_s: [0.0; 3],
            acceleration_m_s2: [1.0, 2.0, 3.0],
            present: 1.0,
        };
        let mut around = Surroundings { load: measured, ..Surroundings::calm() };
        let mut memory = vec![0.0; drone.memory_len(DT)];
        let mut command = Command::Rotors([0.0; MAX_ROTORS]);
        drone.transmit(&State::rest(), &mut around, (DT, DT), &mut command, &mut memory);
        assert_eq!(around.load, measured);
        let acc = drone.rate(&State::rest(), &command, &around).acc;
        for (a, b) in acc.iter().zip([-0.2, -0.4, -9.81 - 0.2 * (9.81 + 3.0)]) {
            assert!((a - b).abs() < 1e-12, "{acc:?}");
        }
    }

    #[test]
    fn a_load_seen_from_outside_gives_the_pendulum_back_and_the_tension_follows_from_the_vehicle() {
        let p = load_of(0.2, 0.5);
        let state = State { pos: [1.0, 2.0, 3.0], vel: [0.5, -0.2, 0.1], ..State::rest() };
        let pivot = p.pivot(&state, [1.0, -0.5, 2.0], [0.0; 3]);
        let pendulum = Pendulum { direction: [0.6, 0.0, -0.8], rate_per_s: [0.8, 1.0, 0.6] };
        let load = p.load(&pendulum, &pivot, G);
        let seen = Pendulum::seen(load.position_m, load.velocity_m_s, &pivot);
        for i in 0..3 {
            assert!((seen.direction[i] - pendulum.direction[i]).abs() < 1e-12);
            assert!((seen.rate_per_s[i] - pendulum.rate_per_s[i]).abs() < 1e-12);
        }
        // Without damping the pull lies along the cable: (g − a)·n + l |ṅ|².
        let pull = vec3::sub(G, load.acceleration_m_s2);
        let tension = vec3::dot(vec3::sub(G, [1.0, -0.5, 2.0]), pendulum.direction) + 0.5 * 2.0;
        assert!((vec3::dot(pull, pendulum.direction) - tension).abs() < 1e-12);
        assert!(vec3::norm(across(pull, pendulum.direction)) < 1e-12);
    }

    #[test]
    fn a_pendulum_driven_by_the_recorded_motion_pulls_as_the_simulated_one_did() {
        let p = Params { damping_per_s: 0.2, attachment_m: [0.0, 0.0, -0.02], ..load_of(0.2, 0.5) };
        let mut flight = Flight::new(p, Pendulum::hanging(G));
        let hover = flight.drone.hover_rotor_vel();
        let mut record = Vec::new();
        for step in 0..1500 {
            // Sideways pushes by unequal rotors, which roll the vehicle a little to both sides.
            let lean = if step / 100 % 2 == 0 { 1.002 } else { 0.998 };
            let rotors =
                [hover[0] * lean, hover[1] * lean, hover[2] / lean, hover[3] / lean, 0.0, 0.0, 0.0, 0.0];
            let before = flight.state;
            record.push((before, flight.step(rotors)));
        }
        let mut pendulum = Pendulum::hanging(G);
        let (mut largest, mut worst) = (0.0f64, 0.0f64);
        for pair in record.windows(2) {
            let ((now, simulated), (next, _)) = (pair[0], pair[1]);
            let rate = |a: [f64; 3], b: [f64; 3]| vec3::scale(vec3::sub(b, a), 1.0 / DT);
            let pivot = p.pivot(&now, rate(now.vel, next.vel), rate(now.ang_vel, next.ang_vel));
            let load = p.load(&pendulum, &pivot, G);
            let difference = vec3::sub(load.acceleration_m_s2, simulated.acceleration_m_s2);
            worst = worst.max(vec3::norm(difference));
            largest = largest.max(vec3::norm(load.acceleration_m_s2));
            pendulum = p.advance(&pendulum, pivot.acceleration_m_s2, G, DT);
        }
        assert!(largest > 0.3 && worst < 0.1 * largest, "{worst} of {largest} m/s²");
    }

    #[test]
    fn the_pendulum_has_exact_derivatives_by_its_parameters() {
        type D = Dual<f64, 1>;
        fn end<S: Real>(length: S) -> S {
            let mut p: Params<S> = Parameters::map(&Params::default(), &mut S::lit);
            p.cable_length_m = length;
            let mut pendulum =
                Pendulum { direction: [0.6, 0.0, -0.8].map(S::lit), rate_per_s: [0.0, 1.0, 0.0].map(S::lit) };
            for _ in 0..100 {
                pendulum = p.advance(&pendulum, [1.0, 0.0, 0.5].map(S::lit), G.map(S::lit), S::lit(0.005));
            }
            pendulum.direction[0]
        }
        let exact = end(D::input(0.5, 0)).partials[0];
        let difference = (end(0.5 + 1e-6) - end(0.5 - 1e-6)) / 2e-6;
        assert!((exact - difference).abs() < 1e-6 * exact.abs() && exact.abs() > 0.1, "{exact} {difference}");
    }
}
