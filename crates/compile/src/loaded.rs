//! Compiled code in memory.

use core::ffi::c_long;
use std::path::Path;

use libloading::Library;
use propwash_trace::lanes::Cell;

use crate::{CompileError, Sizes};

type Call = unsafe extern "C" fn(*mut u8);
type Step = unsafe extern "C" fn(*mut u8, *mut u8, c_long, *const u8);
type Epilogue = unsafe extern "C" fn(*mut u8, *mut u8);

/// Bytes of a cell of compiled code.
const CELL: usize = 64;

/// The functions of a compiled step. They stay loaded until the process ends.
#[derive(Clone, Copy, Debug)]
pub struct Code {
    call: Call,
    step: Step,
    epilogue: Epilogue,
    /// Bytes of a number.
    number: usize,
    sizes: Sizes,
}

impl Code {
    /// Loads a library that the compiler made of a printed step.
    pub(crate) fn load(file: &Path, number: usize, sizes: Sizes) -> Result<Self, CompileError> {
        let failed = |e: libloading::Error| {
            // What the system says stands behind the error.
            let why = core::error::Error::source(&e).map_or_else(String::new, |why| format!(": {why}"));
            CompileError::Load { file: file.display().to_string(), message: format!("{e}{why}") }
        };
        // SAFETY: the file was made by the compiler of what `export::c` printed, or has the checksum that was written when it was. It has no
        // initialisers, and its three functions have the types below.
        let (library, call, step, epilogue) = unsafe {
            let library = Library::new(file).map_err(failed)?;
            let call: Call = *library.get(b"pw_call\0").map_err(failed)?;
            let step: Step = *library.get(b"pw_step\0").map_err(failed)?;
            let epilogue: Epilogue = *library.get(b"pw_epilogue\0").map_err(failed)?;
            (library, call, step, epilogue)
        };
        // Never unloaded: simulations hold the addresses of its functions.
        core::mem::forget(library);
        Ok(Self { call, step, epilogue, number, sizes })
    }

    /// Whether it runs on cells of this type: single blocks of lanes of its number.
    pub fn is_for<C: Cell>(&self) -> bool {
        size_of::<C>() == CELL && align_of::<C>() == CELL && size_of::<C::Number>() == self.number
    }

    /// Panics unless the arrays are what the code expects: a caller that has them wrong would have it write elsewhere.
    fn check<C: Cell>(&self, home: Option<&[C]>, scratch: &[C]) {
        let Sizes { home: of_home, scratch: of_scratch, .. } = self.sizes;
        let enough = home.is_none_or(|home| home.len() >= of_home) && scratch.len() >= of_scratch;
        assert!(enough && self.is_for::<C>(), "compiled code runs on the cells that it was compiled for");
    }

    /// Fills the per-call table.
    ///
    /// # Panics
    /// Where the cells are not [those](Code::is_for) of the code, or fewer than it reaches.
    #[inline]
    pub fn call<C: Cell>(&self, scratch: &mut [C]) {
        self.check(None, scratch);
        // SAFETY: `check` says that all that the function reaches is there, aligned.
        unsafe { (self.call)(scratch.as_mut_ptr().cast()) }
    }

    /// Takes so many steps, with what is given anew before each as it stands in the home.
    ///
    /// # Panics
    /// As [`Code::call`].
    #[inline]
    pub fn step<C: Cell>(&self, home: &mut [C], scratch: &mut [C], times: usize) {
        self.check(Some(home), scratch);
        // SAFETY: as above; the two slices do not overlap, since both are borrowed mutably. Where the last argument is null it is not read.
        unsafe {
            (self.step)(
                home.as_mut_ptr().cast(),
                scratch.as_mut_ptr().cast(),
                times as c_long,
                core::ptr::null(),
            );
        }
    }

    /// A step for each row of `fresh`: what is given anew before it, the same in all lanes. What stands in the home instead is not read.
    ///
    /// # Panics
    /// As [`Code::call`], where nothing is given anew, and where the last row is cut off.
    #[inline]
    pub fn steps<C: Cell>(&self, home: &mut [C], scratch: &mut [C], fresh: &[C::Number]) {
        self.check(Some(home), scratch);
        let times = fresh.len() / self.sizes.fresh;
        assert!(times * self.sizes.fresh == fresh.len(), "rows of {} numbers each", self.sizes.fresh);
        // SAFETY: as above; the function reads `times` rows of as many numbers.
        unsafe {
            (self.step)(
                home.as_mut_ptr().cast(),
                scratch.as_mut_ptr().cast(),
                times as c_long,
                fresh.as_ptr().cast(),
            );
        }
    }

    /// Computes what is only needed after the last step.
    ///
    /// # Panics
    /// As [`Code::call`].
    #[inline]
    pub fn epilogue<C: Cell>(&self, home: &mut [C], scratch: &mut [C]) {
        self.check(Some(home), scratch);
        // SAFETY: as above.
        unsafe { (self.epilogue)(home.as_mut_ptr().cast(), scratch.as_mut_ptr().cast()) }
    }
}
