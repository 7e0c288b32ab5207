//! What a controller makes of rotor places: from thrusts to force and torque, and back by the pseudo-inverse.

use nalgebra::{Matrix4xX, RowVector4};
use propwash_physics::controllers::mixer::Params;
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_physics::rotor;

/// Singular values below this share of the greatest count as zero.
const RANK_TOLERANCE: f64 = 1e-9;

/// The mixer of `rotors` whose torque about the axis is `thrust_to_torque_m` (m, one per rotor) times their thrust, and
/// the rank of its matrix: 4 if every thrust and torque can be made.
///
/// Thrust is counted along body z, torque about the centre of mass. With more than four rotors the thrusts of least
/// squared sum are taken (Moore–Penrose pseudo-inverse); with a lower rank they make the nearest force and torque.
pub(super) fn mixer(rotors: &[rotor::Params<f64>], thrust_to_torque_m: &[f64]) -> (Params<f64>, usize) {
    let n = rotors.len();
    // Columns are rotors, rows thrust and torque x, y, z.
    let mut effect = Matrix4xX::zeros(n);
    for (i, (r, t2t)) in rotors.iter().zip(thrust_to_torque_m).enumerate() {
        let ([x, y, z], [ax, ay, az]) = (r.position_m, r.axis);
        let drag = r.spin * t2t;
        effect[(0, i)] = az;
        effect[(1, i)] = y * az - z * ay + drag * ax;
        effect[(2, i)] = z * ax - x * az + drag * ay;
        effect[(3, i)] = x * ay - y * ax + drag * az;
    }
    // Rows of like size make the rank independent of units; of full rows the pseudo-inverse is the same after undoing it.
    let scale = RowVector4::from_fn(|_, k| {
        let most = effect.row(k).amax();
        if most > 0.0 { most } else { 1.0 }
    });
    let mut scaled = effect.clone();
    for k in 0..4 {
        // Divided, not multiplied by the inverse: equal levers then give exactly ±1.
        scaled.row_mut(k).apply(|x| *x /= scale[k]);
    }
    let svd = scaled.clone().svd(true, true);
    let threshold = svd.singular_values.max() * RANK_TOLERANCE;
    let rank = svd.rank(threshold);
    let inverse = svd.pseudo_inverse(threshold).ok();

    let mut out = Params {
        signs: [[0.0; 3]; MAX_ROTORS],
        rotor_from_wrench: [[0.0; 4]; MAX_ROTORS],
        wrench_from_rotor: [[0.0; 4]; MAX_ROTORS],
        beside: [[0.0; 4]; 4],
        n_rotors: n,
    };
    for i in 0..n {
        for k in 0..4 {
            out.wrench_from_rotor[i][k] = effect[(k, i)];
            if let Some(inverse) = &inverse {
                out.rotor_from_wrench[i][k] = inverse[(i, k)] / scale[k];
            }
        }
        for k in 0..3 {
            out.signs[i][k] = scaled[(k + 1, i)];
        }
    }
    out.refresh();
    (out, rank)
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_physics::controllers::mixer::{rotors_from_rotors, rotors_from_wrench, wrench_from_rotors};

    fn rotor(position_m: [f64; 3], axis: [f64; 3], spin: f64) -> rotor::Params<f64> {
        rotor::Params {
            position_m,
            axis,
            spin,
            thrust_curve: [0.0, 0.0, 1e-8],
            torque_curve: [0.0, 0.0, 1e-10],
            spin_up: [1.0, 0.0],
            spin_down: [1.0, 0.0],
            inertia_kg_m2: 0.0,
            radius_m: 0.1,
        }
    }

    fn ring(n: usize, tilt: f64) -> Vec<rotor::Params<f64>> {
        (0..n)
            .map(|i| {
                let angle = (i as f64 + 0.5) * std::f64::consts::TAU / n as f64;
                let side = if i % 2 == 0 { tilt } else { -tilt };
                let axis = [-angle.sin() * side.sin(), angle.cos() * side.sin(), side.cos()];
                rotor([0.2 * angle.cos(), 0.2 * angle.sin(), 0.01], axis, if i % 2 == 0 { 1.0 } else { -1.0 })
            })
            .collect()
    }

    #[test]
    fn an_x_quad_has_the_signs_and_the_inverse_of_the_firmware() {
        let (arm, t2t) = (0.03253, 0.007350862856566459);
        // Rows of Crazyflow's mixing_matrix: roll, pitch, yaw per rotor.
        let rows = [[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]];
        let rotors: Vec<_> = (0..4)
            .map(|i| rotor([-arm * rows[1][i], arm * rows[0][i], 0.0], [0.0, 0.0, 1.0], rows[2][i]))
            .collect();
        let (mixer, rank) = mixer(&rotors, &[t2t; 4]);
        assert_eq!((rank, mixer.n_rotors), (4, 4));
        for i in 0..4 {
            let sign = [rows[0][i], rows[1][i], rows[2][i]];
            assert_eq!(mixer.signs[i], sign);
            assert_eq!(mixer.wrench_from_rotor[i], [1.0, arm * sign[0], arm * sign[1], t2t * sign[2]]);
            let want = [0.25, sign[0] / (4.0 * arm), sign[1] / (4.0 * arm), sign[2] / (4.0 * t2t)];
            for k in 0..4 {
                let error = mixer.rotor_from_wrench[i][k] / want[k] - 1.0;
                assert!(error.abs() < 1e-12, "rotor {i}, column {k}: {error:e}");
            }
        }
    }

    #[test]
    fn thrusts_come_back_through_the_wrench_as_the_staged_way_gives_them() {
        // A quadrotor, one whose rotors all turn alike and make no yaw torque of their own, and a hexarotor.
        let mut alike = ring(4, 0.0);
        alike.iter_mut().for_each(|r| r.spin = 1.0);
        for (rotors, full) in [(ring(4, 0.0), true), (alike, false), (ring(6, 0.3), true)] {
            let (mixer, rank) = mixer(&rotors, &vec![0.02; rotors.len()]);
            assert_eq!(rank == 4, full);
            let beside = mixer.beside.iter().flatten().any(|v| *v != 0.0);
            assert_eq!(beside, !full && rotors.len() == 4, "{:?}", mixer.beside);
            let thrust = [2.0, 2.3, 1.7, 2.6, 1.1, 0.4, 0.0, 0.0];
            let given: [f64; MAX_ROTORS] =
                core::array::from_fn(|i| if i < rotors.len() { thrust[i] } else { 0.0 });
            let staged = rotors_from_wrench(&mixer, wrench_from_rotors(&mixer, &given));
            let short = rotors_from_rotors(&mixer, &given);
            for i in 0..rotors.len() {
                assert!((short[i] - staged[i]).abs() < 1e-12, "{short:?} is not {staged:?}");
            }
        }
    }

    #[test]
    fn a_tilted_hexarotor_gives_back_the_wrench_that_was_asked_for() {
        let rotors = ring(6, 0.3);
        let (mixer, rank) = mixer(&rotors, &[0.02; 6]);
        assert_eq!(rank, 4);
        let wrench = [9.0, 0.2, -0.3, 0.05];
        let thrusts = rotors_from_wrench(&mixer, wrench);
        let back = wrench_from_rotors(&mixer, &thrusts);
        for k in 0..4 {
            assert!((back[k] - wrench[k]).abs() < 1e-12, "{back:?}");
        }
        // The controller's belief is what the airframe does.
        let mut all = [rotors[0]; MAX_ROTORS];
        all[..6].copy_from_slice(&rotors);
        let airframe = propwash_physics::airframe::Params { rotors: all, n_rotors: 6 };
        let torque = thrusts.map(|t| 0.02 * t);
        let loads = propwash_physics::airframe::Loads { thrust: thrusts, torque };
        let still = [0.0; MAX_ROTORS];
        let (force, moment) = propwash_physics::airframe::wrench(&airframe, &loads, &still, &still, [0.0; 3]);
        assert!((force[2] - wrench[0]).abs() < 1e-12);
        for k in 0..3 {
            assert!((moment[k] - wrench[k + 1]).abs() < 1e-12, "{moment:?}");
        }
    }

    #[test]
    fn rotors_that_all_turn_one_way_cannot_make_thrust_and_yaw_apart() {
        let mut rotors = ring(4, 0.0);
        for r in &mut rotors {
            r.spin = 1.0;
        }
        assert_eq!(mixer(&rotors, &[0.02; 4]).1, 3);
        assert_eq!(mixer(&ring(3, 0.0), &[0.02; 3]).1, 3);
        assert_eq!(mixer(&ring(1, 0.0), &[0.02; 1]).1, 1);
        assert_eq!(mixer(&ring(4, 0.0), &[0.0; 4]).1, 3);
    }
}
