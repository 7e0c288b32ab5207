//! Numbers, tables and comments of TOML text being edited.

use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value};

/// A parameter's key and the indices into its array.
pub(super) fn split(name: &str) -> (&str, Vec<usize>) {
    let mut parts = name.split('.');
    let base = parts.next().unwrap_or(name);
    (base, parts.filter_map(|p| p.parse().ok()).collect())
}

/// A number as a TOML value, small and large ones in scientific notation; it parses back bit for bit.
pub(super) fn number(v: f64) -> Value {
    let plain = v == 0.0 || (1e-3..1e6).contains(&v.abs());
    let text = if plain { format!("{v:?}") } else { format!("{v:e}") };
    text.parse().unwrap_or_else(|_| Value::from(v))
}

/// The number at the given indices of an array; the value itself without indices.
pub(super) fn number_at(value: &Value, path: &[usize]) -> Option<f64> {
    let mut at = value;
    for i in path {
        at = at.as_array()?.get(*i)?;
    }
    at.as_float().or(at.as_integer().map(|i| i as f64))
}

/// Replaces the number at some indices and keeps the comment beside it.
pub(super) fn set_number_at(value: &mut Value, path: &[usize], v: f64) {
    let mut at = value;
    for i in path {
        let Some(inner) = at.as_array_mut().and_then(|a| a.get_mut(*i)) else { return };
        at = inner;
    }
    let decor = at.decor().clone();
    *at = number(v);
    *at.decor_mut() = decor;
}

/// A sigma by indices, from an array or from a table keyed by index.
pub(super) fn sigma_at(item: &Item, path: &[usize]) -> Option<f64> {
    let Some((first, rest)) = path.split_first() else {
        return item.as_float().or(item.as_integer().map(|i| i as f64));
    };
    match item {
        Item::Value(value @ Value::Array(_)) => number_at(value, path),
        other => sigma_at(other.as_table_like()?.get(&first.to_string())?, rest),
    }
}

/// A number, or nested arrays, of all numbers of a parameter in order; a matrix with one row per line.
pub(super) fn built(all: &[(Vec<usize>, f64)]) -> Value {
    match all {
        [(path, v)] if path.is_empty() => number(*v),
        _ => {
            let mut out = Array::new();
            let mut rest = all;
            let mut is_matrix = false;
            while let Some(first) = rest.first().and_then(|(path, _)| path.first()) {
                let n = rest.iter().take_while(|(path, _)| path.first() == Some(first)).count();
                let row: Vec<(Vec<usize>, f64)> =
                    rest[..n].iter().map(|(path, v)| (path[1..].to_vec(), *v)).collect();
                let mut value = built(&row);
                if value.is_array() {
                    is_matrix = true;
                    value.decor_mut().set_prefix("\n    ");
                    out.push_formatted(value);
                } else {
                    out.push(value);
                }
                rest = &rest[n..];
            }
            if is_matrix {
                out.set_trailing("\n");
                out.set_trailing_comma(true);
            }
            Value::Array(out)
        }
    }
}

/// `0.0 = …, 1.1 = …`: the numbers that are known, by index.
pub(super) fn by_index(known: &[(Vec<usize>, f64)]) -> InlineTable {
    let mut out = InlineTable::new();
    out.set_dotted(true);
    let mut rest = known;
    while let Some(first) = rest.first().and_then(|(path, _)| path.first()) {
        let n = rest.iter().take_while(|(path, _)| path.first() == Some(first)).count();
        let inner: Vec<(Vec<usize>, f64)> =
            rest[..n].iter().map(|(path, v)| (path[1..].to_vec(), *v)).collect();
        let value = match inner.as_slice() {
            [(path, v)] if path.is_empty() => number(*v),
            _ => Value::InlineTable(by_index(&inner)),
        };
        out.insert(first.to_string(), value);
        rest = &rest[n..];
    }
    out
}

/// Tables below a table.
fn below(table: &Table) -> impl Iterator<Item = &Table> {
    table.iter().flat_map(|(_, item)| {
        let one = item.as_table().into_iter();
        one.chain(item.as_array_of_tables().into_iter().flat_map(ArrayOfTables::iter))
    })
}

/// Tables below a table.
fn below_mut(table: &mut Table) -> impl Iterator<Item = &mut Table> {
    table.iter_mut().flat_map(|(_, item)| -> Vec<&mut Table> {
        match item {
            Item::Table(one) => vec![one],
            Item::ArrayOfTables(list) => list.iter_mut().collect(),
            _ => Vec::new(),
        }
    })
}

/// Clears the position of a copied entry, so that it follows the table before it.
pub(super) fn forget_positions(table: &mut Table) {
    table.set_position(None);
    below_mut(table).for_each(forget_positions);
}

/// Position in the file of the last table of a tree.
pub(super) fn last_position(table: &Table) -> Option<isize> {
    below(table).map(last_position).chain([table.position()]).max().flatten()
}

/// Position of the first table of a tree after `limit`.
fn first_after(table: &Table, limit: isize) -> Option<isize> {
    let own = table.position().filter(|p| *p > limit);
    below(table).filter_map(|t| first_after(t, limit)).chain(own).min()
}

fn table_at(table: &mut Table, position: isize) -> Option<&mut Table> {
    if table.position() == Some(position) {
        return Some(table);
    }
    below_mut(table).find_map(|t| table_at(t, position))
}

/// Moves the comments above a removed table, up to the nearest empty line, to what follows.
pub(super) fn keep_comments(doc: &mut DocumentMut, gone: &Table) {
    let above = gone.decor().prefix().and_then(|p| p.as_str()).unwrap_or("");
    let lines: Vec<&str> = above.split_inclusive('\n').collect();
    // The first line is the end of the table before, or empty.
    let Some(empty) = lines.iter().rposition(|l| l.trim().is_empty()) else { return };
    let kept = lines[..empty].concat();
    if !kept.contains('#') {
        return;
    }
    let next = last_position(gone).and_then(|limit| first_after(doc.as_table(), limit));
    match next.and_then(|position| table_at(doc.as_table_mut(), position)) {
        Some(table) => {
            let old = table.decor().prefix().and_then(|p| p.as_str()).unwrap_or("");
            let all = format!("{kept}{}{old}", if old.starts_with(['\n', '\r']) { "" } else { "\n" });
            table.decor_mut().set_prefix(all);
        }
        None => {
            let old = doc.trailing().as_str().unwrap_or("");
            let all = format!("{kept}{old}");
            doc.set_trailing(all);
        }
    }
}
