//! Compiled code against byte code, bit by bit, and what can go wrong on the way.

use std::fs;
use std::path::Path;

use fearless_simd::Level;
use propwash_trace::Real;
use propwash_trace::bytecode::{Interpret, Program};
use propwash_trace::export::c::{Target, kernel};
use propwash_trace::lanes::{Cell, F32x16, F64x8, Number, level};
use propwash_trace::schedule::{Input, Location, Output, Schedule, schedule};
use propwash_trace::trace::{Sym, trace};

use crate::loaded::Code;
use crate::{CompileError, Sizes, cache, compiler};

/// Carried numbers of the step below: two that change, and one for each result.
const RESULTS: usize = 16;

/// A step with every operation there is, on two numbers that it changes, one that is given and one that is fixed.
/// `many`: with more numbers alive at once than registers hold twice.
fn everything(many: bool) -> Schedule {
    let graph = trace(5, |v| {
        let (fixed, given, a, b, anew) = (v[0], v[1], v[2], v[3], v[4]);
        let (sin, cos) = (a * given).sin_cos();
        let (half, whole) = (a * a).half_turn();
        let near = a.lt(b) & !(b.le(fixed * given)) | a.gt(given);
        let mut out: Vec<Sym> = vec![a + b * given, a * b - given + anew];
        if many {
            let own: Vec<Sym> = (0..240).map(|k| (a * given + b * Sym::lit(f64::from(k))).floor()).collect();
            let products = (0..240).map(|k| own[k] * own[(37 * k + 11) % 240]);
            out[1] = out[1] + products.reduce(|sum, v| sum + v).unwrap_or(a) * Sym::lit(1e-6);
        }
        out.extend([
            sin,
            cos,
            half,
            whole,
            a.exp(),
            (b - a).exp(),
            a.atan2(b),
            (a * fixed).floor(),
            a.abs().sqrt(),
        ]);
        out.extend([
            Sym::select(near, a, b),
            a.min(b),
            a.max(b),
            given - a * b,
            a / fixed,
            -a / (b + given),
            (given * fixed).exp() * a,
        ]);
        out
    });
    let anew = Input::Fresh(3 + RESULTS as u32);
    let inputs = [Input::Fixed(0), Input::Given(2), Input::Carried(0), Input::Carried(1), anew];
    let mut outputs = vec![Output::Carried(0), Output::Carried(1)];
    outputs.extend((0..RESULTS as u32).map(|k| Output::Final(3 + k)));
    schedule(&graph, &inputs, &outputs)
}

/// The file of cells before a call: home, then scratch and registers of the program.
fn file<C: Cell>(schedule: &Schedule, program: &Program, n_home: usize, numbers: &[f64]) -> Vec<C> {
    let mut file = vec![C::splat(C::Number::zero()); n_home + program.len];
    for (k, v) in schedule.once.eval(&[0.75]).iter().enumerate() {
        file[n_home + k] = C::splat(C::Number::of(*v));
    }
    for (cell, v) in file[program.constants_at..].iter_mut().zip(&program.constants) {
        *cell = C::splat(C::Number::constant(*v));
    }
    for p in 0..3 {
        for lane in 0..C::LANES {
            file[p].set(lane, C::Number::of(numbers[(lane * 3 + p) % numbers.len()]));
        }
    }
    for (input, at) in schedule.given.iter().zip(schedule.given_at()) {
        if let (Some(p), Location::Scratch(k)) = (input.place(), at) {
            file[n_home + k as usize] = file[p as usize];
        }
    }
    file
}

/// Compares compiled code with byte code at a level, over ordinary and extraordinary numbers.
fn compare<C: Interpret>(folder: &Path, level: Level, target: Target, many: bool) {
    let schedule = everything(many);
    let n_home = 4 + RESULTS;
    let program = Program::new(&schedule, n_home);
    let source = kernel::<C::Number>(&schedule, target);
    let halves = target == Target::Avx2 && !many;
    assert_eq!(source.contains("HalfMask"), halves, "{target:?}");
    let to = folder.join(format!("{target:?}{}{many}.so", C::Number::NAME));
    compiler::build(&source, target, &to).unwrap();
    let code = Code::load(&to, size_of::<C::Number>(), Sizes::of(&schedule)).unwrap();
    assert!(code.is_for::<C>() && !code.is_for::<[C; 2]>());
    let mut numbers: Vec<f64> = vec![
        0.0,
        -0.0,
        1.0,
        -1.0,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
        1e-42,
        3e38,
        -88.9,
        710.0,
        1e-310,
        4.0,
    ];
    for k in 0..400 {
        let x = f64::from(k);
        numbers.push((x * 0.731).sin() * (x * 0.05 - 6.0).exp2());
    }
    for shift in (0..numbers.len()).step_by(5) {
        numbers.rotate_left(shift % 7 + 1);
        for (times, anew) in [(1, false), (3, false), (1, true), (3, true)] {
            let mut by_byte_code: Vec<C> = file(&schedule, &program, n_home, &numbers);
            let mut compiled = by_byte_code.clone();
            C::interpret(level, &program.call, &mut by_byte_code, 1);
            let given: Vec<C::Number> = numbers[..times].iter().map(|v| C::Number::of(*v)).collect();
            if anew {
                for v in &given {
                    by_byte_code[n_home - 1] = C::splat(*v);
                    C::interpret(level, &program.step, &mut by_byte_code, 1);
                }
            } else {
                C::interpret(level, &program.step, &mut by_byte_code, times);
            }
            C::interpret(level, &program.epilogue, &mut by_byte_code, 1);
            let (home, scratch) = compiled.split_at_mut(n_home);
            code.call(scratch);
            if anew {
                code.steps(home, scratch, &given);
                home[n_home - 1] = C::splat(given[times - 1]);
            } else {
                code.step(home, scratch, times);
            }
            code.epilogue(home, scratch);
            for p in 0..n_home {
                for lane in 0..C::LANES {
                    let (a, b) = (by_byte_code[p].get(lane).wide(), compiled[p].get(lane).wide());
                    // A NaN is one, whatever its bits.
                    let same = a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
                    assert!(same, "{target:?} {} place {p}, lane {lane}: {a:e} and {b:e}", C::Number::NAME);
                }
            }
        }
    }
}

#[test]
fn compiled_code_has_the_bits_of_byte_code_at_every_level() {
    let folder = tempfile::tempdir().unwrap();
    let mut levels = vec![level()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(level().as_avx2().map(Level::Avx2));
        levels.extend(level().as_sse4_2().map(Level::Sse4_2));
    }
    let mut compared = 0;
    for level in levels {
        let Some(target) = Target::of(level) else { continue };
        for many in [false, true] {
            compare::<F32x16>(folder.path(), level, target, many);
            compare::<F64x8>(folder.path(), level, target, many);
        }
        compared += 1;
    }
    assert!(compared > 0, "nothing is compiled for {:?}", level());
}

#[test]
fn what_the_cache_holds_is_used_only_while_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("below");
    let put = |text: &'static str| cache::put(&folder, "step", |to| write(to, text));
    assert_eq!(cache::find(&folder, "step"), None);
    let file = put("whole").unwrap();
    assert_eq!(cache::find(&folder, "step"), Some(file.clone()));
    // Cut off, and with the sum of another.
    fs::write(&file, "who").unwrap();
    assert_eq!(cache::find(&folder, "step"), None);
    put("another").unwrap();
    assert_eq!(cache::find(&folder, "step"), Some(file.clone()));
    fs::remove_file(file.with_extension("sum")).unwrap();
    assert_eq!(cache::find(&folder, "step"), None);
    // A build that fails leaves nothing, and what was there.
    put("whole").unwrap();
    let failed = cache::put(&folder, "step", |to| {
        write(to, "half")?;
        Err(CompileError::Compiler { compiler: "cc".into(), message: "no space left on device".into() })
    });
    assert!(failed.unwrap_err().to_string().contains("no space left"));
    assert_eq!(fs::read_to_string(&file).unwrap(), "whole");
    let left: Vec<_> = fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
    // A file where the folder should be.
    let message = cache::put(&file, "step", |_| Ok(())).unwrap_err().to_string();
    assert!(message.contains("PROPWASH_CACHE"), "{message}");
}

fn write(to: &Path, text: &str) -> Result<(), CompileError> {
    fs::write(to, text).unwrap();
    Ok(())
}

#[cfg(unix)]
#[test]
fn nothing_is_loaded_from_a_folder_that_others_may_write_to() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777)).unwrap();
    let message = cache::put(folder.path(), "step", |_| Ok(())).unwrap_err().to_string();
    assert!(message.contains("others may write"), "{message}");
}

#[test]
fn code_that_does_not_compile_and_files_that_do_not_load_are_errors_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let Some(target) = Target::of(level()) else { return };
    let to = folder.path().join("x.so");
    let message = compiler::build("int f( {", target, &to).unwrap_err().to_string();
    assert!(message.contains("failed: exit status: 1") && message.contains("error"), "{message}");
    fs::write(&to, "no library").unwrap();
    let message = Code::load(&to, 4, Sizes { home: 1, scratch: 1, fresh: 0 }).unwrap_err().to_string();
    assert!(message.contains("x.so cannot be loaded") && message.contains("noexec"), "{message}");
}
