//! Steps run in a way of the user's own, in place of kernels and byte code.

use core::fmt::Debug;

use propwash_trace::lanes::Number;
use propwash_trace::schedule::Schedule;

/// Runs the steps of drones: on other hardware, in another arithmetic, or while something is measured.
///
/// [`Sim::set_backend`](super::Sim::set_backend) puts one in force. The simulation still traces the step of each kind of drone, brings the
/// numbers of the drones in and out, draws random numbers and watches for states that are not finite. What a backend gets is the
/// [`Schedule`], straight-line code that it can interpret, print or compile.
pub trait Backend<N: Number>: Debug + Send + Sync {
    /// Makes the code of a step ready to run. It is asked once for each kind of drone and set of control stages that tick together, and
    /// again where parameters begin to differ between drones.
    fn prepare(&self, schedule: &Schedule) -> Box<dyn PreparedStep<N>>;
}

/// The code of one step, ready to run on several drones at once.
///
/// `home` holds the state slots, shape (slot, drone); `scratch` the cells of [`Schedule::n_scratch`], shape (cell, drone):
/// `[constant table | given | per-call table | numbers for the epilogue]`, the first two of them filled. Where each number stands say
/// [`Schedule::given_at`], [`Schedule::call_at`] and [`Schedule::state_at`]. Drones must not read each other's numbers, and a drone's
/// results must not depend on how many others come with it: then the same seed gives the same bits for any batch.
pub trait PreparedStep<N: Number>: Debug + Send + Sync {
    /// Fills the per-call table by [`Schedule::call`].
    fn call(&self, drones: usize, scratch: &mut [N]);

    /// Takes `times` steps, one or more, by [`Schedule::step`].
    fn step(&self, drones: usize, home: &mut [N], scratch: &mut [N], times: usize);

    /// Computes what is needed after the last step only, by [`Schedule::epilogue`].
    fn epilogue(&self, drones: usize, home: &mut [N], scratch: &mut [N]);
}
