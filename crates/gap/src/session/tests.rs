//! What a session writes down; what it does with flights is tested with hidden effects (`tests/lab.rs` of the root).

use super::own::{Axis, Own};
use super::saved::{LineChange, diff};
use super::written::{Put, expression_of, expression_words};
use crate::GapError;
use propwash_vehicle::Vehicle;

#[test]
fn a_value_says_itself_as_the_command_line_takes_it() {
    let put = |sigma| Put {
        id: "weak_rotor.2".into(),
        parameter: "factor.2".into(),
        value: 0.1 + 0.2,
        sigma,
        correction: false,
    };
    for put in [put(None), put(Some(2.7e-6))] {
        assert_eq!(put.to_string().parse::<Put>(), Ok(put.clone()), "{put}");
    }
    for wrong in ["rotor_drag=1", "a:b", "a:b=", "a:b=x", "a:b=1+-0", "a:b=1+--2", "a:b=inf", ":b=1", "a:=1"]
    {
        let said = wrong.parse::<Put>().unwrap_err();
        assert!(said.contains("EFFECT:PARAMETER=VALUE"), "{wrong}: {said}");
    }
}

#[test]
fn lines_of_a_file_are_kept_added_or_removed() {
    let shown = |old: &str, new: &str| -> String {
        let sign = |c| match c {
            LineChange::Kept => ' ',
            LineChange::Added => '+',
            LineChange::Removed => '-',
        };
        diff(old, new).iter().map(|l| format!("{}{} ", sign(l.change), l.text)).collect()
    };
    assert_eq!(shown("a\nb\nc\n", "a\nb\nc\n"), " a  b  c ");
    assert_eq!(shown("a\nb\nc\n", "a\nx\nc\nd\n"), " a -b +x  c +d ");
    assert_eq!(shown("", "a\n"), "+a ");
    assert_eq!(shown("a\na\n", "a\n"), " a -a ");
}

#[test]
fn an_own_expression_is_a_table_that_a_vehicle_file_takes() {
    let own = Own::new("own_1", Axis::TorqueY, "wy * abs(wy)", 1e-4).unwrap();
    assert_eq!(expression_of(&expression_words(&own)).unwrap(), own);
    let text = format!("{}{}", Vehicle::builtin_file("cf2x_L250").unwrap(), own.table());
    let vehicle = Vehicle::from_toml("own", &text).unwrap();
    let entry = vehicle.file().effect.last().unwrap();
    assert_eq!(entry.params["torque_body_n_m"][1].as_str(), Some("k * (wy * abs(wy))"));
    let wrong = |text: &str| match Own::new("own_1", Axis::ForceBodyX, text, 1.0) {
        Err(GapError::Expression { column, .. }) => column,
        other => panic!("{text}: {other:?}"),
    };
    assert_eq!((wrong("k * "), wrong("k * vx_bodi"), wrong("k * (vx + roll)")), (5, 5, 11));
    for name in ["", "1st", "rotor_drag", "a b", "a\"b"] {
        assert!(Own::new(name, Axis::ForceBodyX, "k", 1.0).is_err(), "{name}");
    }
    assert!(expression_of("own_1:up:1:k").is_err() && expression_of("own_1:force_body_x:0:k").is_err());
}
