//! A vehicle file with each kind of effect, strong enough to matter.

use propwash::vehicle::Vehicle;
use std::path::Path;

/// A Crazyflie without its own drag, with what `effects` (TOML) lists.
pub fn vehicle(effects: &str) -> Vehicle {
    let mut file = Vehicle::builtin("cf2x_L250").unwrap().file().clone();
    file.effect.clear();
    let plain = Vehicle::from_file("plain", file).unwrap();
    Vehicle::from_toml("with effects", &format!("{}\n{effects}", plain.to_toml())).unwrap()
}

/// An entry of the vehicle file that makes an effect of this kind matter: the example of its page, or one for this vehicle.
pub fn entry(kind: &str) -> String {
    let own = match kind {
        "downwash" => "drag_area_m2 = 100.0\nspread = 50.0", // felt from anywhere
        "ground_effect" | "ceiling_effect" => "strength = 3.0",
        "rotor_drag" => "drag_n_s2_per_rad_m = 1.0e-6",
        "inflow" => "loss_n_s2_per_rad_m = 1.0e-6",
        "translational_lift" => "lift_n_s2_per_m2 = 0.0005",
        "quadratic_drag" => "drag_n_s2_per_m2 = [0.002, 0.002, 0.002]",
        "blade_flapping" => "moment_n_s2_per_rad = 1.0e-9\nlateral_extra_n_s2_per_rad = -3.0e-10",
        "com_offset" => "offset_m = [0.0005, 0.0, 0.0]",
        "torque_scale" | "rotor_inertia" => "factor = 3.0",
        "thrust_fade" => "rate_per_s = 0.05",
        "actuator_saturation" => "max_rotor_vel_rad_s = 1900.0",
        "expression" => {
            "name = \"mine\"\nlet = [\"pull = where(z < 50, 0.01, 0) * vx_body\", \"slow = 0.002 * held\"]\n\
             memory.held = { start = 0.1, next = \"held + dt * (vx - held) / 0.05\" }\n\
             force_world_n = [\"pull + slow\", \"0.002 / ground_m\", \"0.001 / ceiling_m + 0.001 * normal1 + 0.002 * normal2 - 0.001 * normal3\"]\n\
             rotor_command = [\"rotor_command1 * (1 + 0.01 * held)\", \"rotor_command2\", \"rotor_command3\", \"rotor_command4\"]\n\
             thrust_factor = \"1 + 0.05 * max(0, 1 - ground_m)\""
        }
        _ => "",
    };
    if !own.is_empty() {
        return format!("[[effect]]\nkind = \"{kind}\"\n{own}\n");
    }
    if kind == "network" {
        return network();
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/effects/{kind}.md"));
    let page = std::fs::read_to_string(page).unwrap();
    let example = page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    format!("{example}\n")
}

/// A network that reads the air, the rotors and the ground, with its content in the entry.
fn network() -> String {
    let input = |name: &str, unit: &str, scale: f64, low: f64, high: f64| {
        let range = format!("offset = 0.0\nscale = {scale:?}\nlow = {low:?}\nhigh = {high:?}\nmargin = 1.0");
        format!("[[input]]\nname = \"{name}\"\nunit = \"{unit}\"\n{range}\n")
    };
    let content = [
        "format = \"propwash network 1\"\n".to_string(),
        input("vx_body", "m/s", 2.0, -9.0, 9.0),
        input("rotor_mean", "rad/s", 1000.0, 0.0, 5000.0),
        input("ground_m", "m", 1.0, -1.0, 30.0),
        "[[hidden]]\nweight = [[1.0, 0.2, -0.5], [-0.4, 0.7, 0.3]]\nbias = [0.1, -0.2]\n".into(),
        "[output]\nacts_on = [\"force_body_x_n\", \"torque_body_y_n_m\"]\n".into(),
        "weight = [[0.02, -0.01], [1e-5, 2e-5]]\nbias = [0.01, 0.0]\n".into(),
    ]
    .concat();
    let sha256 = propwash::vehicle::network::keep(&content);
    format!(
        "[[effect]]\nkind = \"network\"\nname = \"mine\"\nfile = \"mine.network.toml\"\nsha256 = \"{sha256}\"\ncontent = '''\n{content}'''\n"
    )
}
