//! Who finds what touches and what is near.
//!
//! [`Collider::Native`] asks `geometry`, which answers what MuJoCo 3.17.0 answers. What is left to MuJoCo, for the one pair of geoms that needs
//! it: how deep two overlap that are no ball and no plane, the contact points of touching pairs without a ball, and all contacts of
//! signed distance fields. Scenes whose contacts depend on more than geoms (flexes, `<pair>`, `<exclude>`, overridden margins) are left to
//! it wholly.

use serde::{Deserialize, Serialize};

use crate::scene::{SceneError, Worker};

/// Who finds contacts and distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Collider {
    /// Propwash's own, with MuJoCo's contact points where two geoms touch that are no balls.
    #[default]
    Native,
    /// `mj_collision` and `mj_geomDistance` of MuJoCo over all geoms: the reference.
    MuJoCo,
}

impl Collider {
    /// Whether `geometry` is asked in the scene of a worker.
    pub(super) fn is_native(self, worker: &Worker) -> Result<bool, SceneError> {
        Ok(self == Self::Native && worker.table()?.mujoco_only().is_none())
    }
}
