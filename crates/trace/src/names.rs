//! Which name was meant by one that does not exist.

/// Names of which one is offered where several hold what was asked for; more are no help.
const MOST_GUESSES: usize = 4;

/// The nearest of the names that there are, where one is near enough to be what was meant: at most two letters apart (capitals do
/// not count) and not wholly another one.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let name = name.to_lowercase();
    let best = known.into_iter().map(|k| (distance(&name, &k.to_lowercase()), k)).min()?;
    (best.0 <= 2 && best.0 < best.1.chars().count()).then_some(best.1)
}

/// `; did you mean …?` where one of the names is near, or a few have the name as one of their words (`drag` of `linear_drag`), else
/// nothing.
pub fn suggestion<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.into_iter().collect();
    if let Some(near) = nearest(name, known.iter().copied()) {
        return format!("; did you mean `{near}`?");
    }
    let word = name.to_lowercase();
    let holds = |k: &&str| k.split(['_', '.']).any(|part| part == word);
    match known.into_iter().filter(holds).collect::<Vec<_>>()[..] {
        [ref first @ .., last] if first.len() < MOST_GUESSES => {
            let first: String = first.iter().map(|k| format!("`{k}` or ")).collect();
            format!("; did you mean {first}`{last}`?")
        }
        _ => String::new(),
    }
}

/// The same for names in one text, separated by commas.
pub fn of_list(name: &str, known: &str) -> String {
    suggestion(name, known.split(", "))
}

/// Fewest insertions, deletions and replacements of letters that lead from one word to the other (Levenshtein).
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let next = (diagonal + usize::from(x != *y)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_that_was_meant_is_found() {
        let known = ["corridor", "forest", "room", "zoo"];
        assert_eq!(nearest("forrest", known), Some("forest"));
        assert_eq!(nearest("Forest", known), Some("forest"));
        assert_eq!(nearest("rom", known), Some("room"));
        assert_eq!(nearest("warehouse", known), None);
        assert_eq!(nearest("ab", ["zz"]), None);
        assert_eq!(nearest("x", []), None);
        assert_eq!(suggestion("zo", known), "; did you mean `zoo`?");
        assert_eq!(suggestion("nothing", known), "");
        let effects = ["linear_drag", "rotor_drag", "payload", "mount.pose", "mount.imu"];
        assert_eq!(suggestion("drag", effects), "; did you mean `linear_drag` or `rotor_drag`?");
        assert_eq!(suggestion("IMU", effects), "; did you mean `mount.imu`?");
        let factors = ["scale_of_a", "scale_of_b", "scale_of_c", "scale_of_d", "scale_of_e"];
        assert_eq!(suggestion("scale", factors), "", "of many none is offered");
        assert_eq!(of_list("linear_darg", "linear_drag, payload"), "; did you mean `linear_drag`?");
    }
}
