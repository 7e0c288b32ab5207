//! Contacts of one pair of geoms, by MuJoCo's collision function for their types.

use std::ffi::c_int;
use std::ptr;

use mujoco_rs::mujoco_c as ffi;

use super::{RawContact, SceneError, Worker};

/// Most contacts that MuJoCo reports for one pair of geoms (mjMAXCONPAIR).
pub(crate) const MAX_PAIR_CONTACTS: usize = ffi::mjMAXCONPAIR as usize;

/// Room for the contacts of one pair.
#[derive(Debug)]
pub(crate) struct PairContacts {
    found: [ffi::mjPreContact; MAX_PAIR_CONTACTS],
    count: usize,
    geom: [i32; 2],
}

impl Default for PairContacts {
    fn default() -> Self {
        let none = || ffi::mjPreContact { dist: 0.0, pos: [0.0; 3], normal: [0.0; 3], tangent: [0.0; 3] };
        Self { found: std::array::from_fn(|_| none()), count: 0, geom: [-1; 2] }
    }
}

impl PairContacts {
    /// What [`Worker::collide_pair`] found last.
    pub fn iter(&self) -> impl Iterator<Item = RawContact> + '_ {
        self.found[..self.count].iter().map(|c| RawContact {
            geom: self.geom,
            flex: [-1; 2],
            distance_m: c.dist,
            point_m: c.pos,
            normal: c.normal,
        })
    }

    pub fn len(&self) -> usize {
        self.count
    }
}

impl Worker {
    /// Finds the contacts of two geoms up to the signed distance `margin_m`, whatever their bits, as `mj_collision` would.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Stale`], [`SceneError::Engine`].
    pub(crate) fn collide_pair(
        &mut self,
        first: usize,
        second: usize,
        margin_m: f64,
        out: &mut PairContacts,
    ) -> Result<(), SceneError> {
        self.ready("contacts")?;
        let kinds = [self.geom_kind(first)? as usize, self.geom_kind(second)? as usize];
        let bodies = [first, second].map(|g| self.scene().geoms()[g].body_id);
        // As mj_collision does: the geom of the lower body first, then the one of the lower type.
        let turned = if kinds[0] == kinds[1] { bodies[1] < bodies[0] } else { kinds[1] < kinds[0] };
        let (a, b) = if turned { (second, first) } else { (first, second) };
        out.geom = [a as i32, b as i32];
        out.count = 0;
        let types = if turned { [kinds[1], kinds[0]] } else { kinds };
        // SAFETY: a table of constants that MuJoCo fills before main; nothing here writes to it.
        let table = unsafe { ptr::read(&raw const ffi::mjCOLLISIONFUNC) };
        let Some(function) = table.get(types[0]).and_then(|row| row.get(types[1])).copied().flatten() else {
            return Ok(());
        };
        let (m, d) = (self.m(), self.data);
        let mut count: c_int = 0;
        let (found, number) = (out.found.as_mut_ptr(), &raw mut count);
        // SAFETY: valid geom ids of types for which the function stands in the table; room for as many contacts as one
        // pair may have.
        unsafe {
            self.engine("a collision of two geoms", || {
                *number = function(m, d, found, a as c_int, b as c_int, margin_m);
            })?;
        }
        out.count = usize::try_from(count).unwrap_or(0).min(MAX_PAIR_CONTACTS);
        Ok(())
    }
}
