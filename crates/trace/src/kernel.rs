//! Generated kernels: how they are declared, looked up and run.

use fearless_simd::Level;

use super::lanes::{Cell, F32x16, F64x8};
use super::schedule::Schedule;

/// Entry points of a kernel for one type of cell, over the drones' state slots (home) and the kernel's scratch, or the
/// scratch alone ([`super::schedule::Location`]).
#[derive(Clone, Copy, Debug)]
pub struct Entries<C> {
    /// Fills the per-call table.
    pub call: fn(Level, &mut [C]),
    /// Takes the given number of steps, at least one.
    pub step: fn(Level, &mut [C], &mut [C], usize),
    /// Epilogue: computes what is only needed after the last step.
    pub epilogue: fn(Level, &mut [C], &mut [C]),
}

/// A scheduled step compiled for several types of cells.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Name of its file.
    pub name: &'static str,
    /// [`key`] of the code from which it was generated.
    pub key: u128,
    /// One number at a time; the results have the same bits as the traced code.
    pub scalar: Entries<f64>,
    /// Sixteen f32 lanes.
    pub f32: Entries<F32x16>,
    /// Eight f64 lanes.
    pub f64: Entries<F64x8>,
}

/// Whether kernels are compiled for a SIMD level: AVX-512, AVX2 and NEON. Older processors run byte code.
pub fn has_level(level: Level) -> bool {
    #[cfg(target_arch = "x86_64")]
    return level.as_avx2().is_some();
    #[cfg(not(target_arch = "x86_64"))]
    return !level.is_fallback();
}

/// Cells for which kernels may be compiled.
pub trait Compiled: Cell {
    /// The kernel's entry points for this cell at a SIMD level; `None` where it has none.
    fn entries(kernel: &Kernel, level: Level) -> Option<Entries<Self>>;
}

macro_rules! compiled {
    ($($cell:ty: $kernel:ident, $level:ident => $entries:expr;)*) => {$(
        impl Compiled for $cell {
            fn entries($kernel: &Kernel, $level: Level) -> Option<Entries<Self>> {
                $entries
            }
        }
    )*};
}
compiled! {
    f64: kernel, _level => Some(kernel.scalar);
    F32x16: kernel, level => has_level(level).then_some(kernel.f32);
    [F32x16; 2]: _kernel, _level => None;
    [[F32x16; 2]; 2]: _kernel, _level => None;
    F64x8: kernel, level => has_level(level).then_some(kernel.f64);
    [F64x8; 2]: _kernel, _level => None;
    [[F64x8; 2]; 2]: _kernel, _level => None;
}

/// 128-bit FNV-1a hash (Fowler, Noll, Vo; RFC 9923).
pub fn hash(bytes: impl IntoIterator<Item = u8>) -> u128 {
    let start: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
    let add =
        |hash: u128, byte| (hash ^ u128::from(byte)).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013b);
    bytes.into_iter().fold(start, add)
}

/// Identifies the code of a schedule and the sizes of their tables: the hash of a text of them.
pub fn key(schedule: &Schedule) -> u128 {
    let cells = (schedule.n_constants, schedule.n_call, schedule.given.len(), schedule.state_at());
    let text = format!("{cells:?} {:?} {:?} {:?}", schedule.call, schedule.step, schedule.epilogue);
    hash(text.bytes())
}

// For the macros below, in crates that do not name it themselves.
#[doc(hidden)]
pub use fearless_simd;

/// Evaluates an expression with the token of a level that [`has_level`], compiled for the features of that level.
#[macro_export]
macro_rules! at_level {
    ($level:expr, $simd:ident => $run:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            let level: $crate::kernel::fearless_simd::Level = $level;
            if let Some($simd) = level.as_avx512() {
                $crate::lanes::vectorize($simd, #[inline(always)] || $run)
            } else if let Some($simd) = level.as_avx2() {
                $crate::lanes::vectorize($simd, #[inline(always)] || $run)
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        $crate::kernel::fearless_simd::dispatch!($level, $simd => $crate::lanes::vectorize($simd, #[inline(always)] || $run))
    }};
}
pub use at_level;

/// Declares a [`Kernel`] from the functions `call`, `step` and `epilogue` in scope.
#[macro_export]
macro_rules! kernel {
    ($name:literal, $key:literal, $home:ident, $scratch:ident) => {{
        use $crate::lanes::{F32x16, F64x8};
        use $crate::kernel::fearless_simd::{Level, Simd, f32x16, f64x8};

        macro_rules! entries {
            ($cell:ty, $arith:ty) => {{
                #[inline(always)]
                fn call_at<S: Simd>(simd: S, f: &mut [$cell; $scratch]) {
                    call::<$arith>(simd, f);
                }
                #[inline(always)]
                fn step_at<S: Simd>(simd: S, h: &mut [$cell; $home], f: &mut [$cell; $scratch], times: usize) {
                    step::<$arith>(simd, h, f, times);
                }
                #[inline(always)]
                fn epilogue_at<S: Simd>(simd: S, h: &mut [$cell; $home], f: &mut [$cell; $scratch]) {
                    epilogue::<$arith>(simd, h, f);
                }
                fn call_all(level: Level, scratch: &mut [$cell]) {
                    let Some(f) = scratch.first_chunk_mut() else { return };
                    $crate::kernel::at_level!(level, simd => call_at(simd, f));
                }
                fn step_all(level: Level, home: &mut [$cell], scratch: &mut [$cell], times: usize) {
                    let (Some(h), Some(f)) = (home.first_chunk_mut(), scratch.first_chunk_mut()) else { return };
                    $crate::kernel::at_level!(level, simd => step_at(simd, h, f, times));
                }
                fn epilogue_all(level: Level, home: &mut [$cell], scratch: &mut [$cell]) {
                    let (Some(h), Some(f)) = (home.first_chunk_mut(), scratch.first_chunk_mut()) else { return };
                    $crate::kernel::at_level!(level, simd => epilogue_at(simd, h, f));
                }
                $crate::kernel::Entries { call: call_all, step: step_all, epilogue: epilogue_all }
            }};
        }
        fn call_one(_: Level, scratch: &mut [f64]) {
            let Some(f) = scratch.first_chunk_mut() else { return };
            call::<f64>((), f);
        }
        fn step_one(_: Level, home: &mut [f64], scratch: &mut [f64], times: usize) {
            let (Some(h), Some(f)) = (home.first_chunk_mut(), scratch.first_chunk_mut()) else { return };
            step::<f64>((), h, f, times);
        }
        fn epilogue_one(_: Level, home: &mut [f64], scratch: &mut [f64]) {
            let (Some(h), Some(f)) = (home.first_chunk_mut(), scratch.first_chunk_mut()) else { return };
            epilogue::<f64>((), h, f);
        }
        Kernel {
            name: $name,
            key: $key,
            scalar: $crate::kernel::Entries { call: call_one, step: step_one, epilogue: epilogue_one },
            f32: entries!(F32x16, f32x16<S>),
            f64: entries!(F64x8, f64x8<S>),
        }
    }};
}
pub use kernel;
