//! The keys of an entry of kind `expression`, from texts to programs.

use super::parser::{FUNCTIONS, Names, parse_with};
use super::{intern, is_identifier};
use crate::DYNAMICS;
use crate::error::VehicleError;
use crate::file::{Check, join};
use crate::schema::EffectEntry;
use propwash_physics::effects::AnyEffect;
use propwash_physics::effects::expression::{
    Formula, Input, Known, MAX_LETS, MAX_MEMORY, Memory, Op, Params, Program, VARIABLES, known,
};

/// Keys that say what an effect does; one at least must be there.
const DOES: [&str; 6] = [
    "force_body_n",
    "force_world_n",
    "torque_body_n_m",
    "thrust_factor",
    "rotor_command",
    "attitude_command",
];

/// Keys that stand beside them.
const BESIDE: [&str; 5] = ["name", "let", "memory", "controls", "parameter"];

/// Names that expressions of an entry may use, as owned texts.
#[derive(Default)]
struct Own {
    parameters: Vec<String>,
    memory: Vec<String>,
    lets: Vec<String>,
}

impl Own {
    /// Whether a new name would mean two things.
    fn takes(&self, name: &str) -> bool {
        let own = [&self.parameters, &self.memory, &self.lets];
        own.into_iter().flatten().any(|n| n == name)
            || VARIABLES.iter().any(|v| v.name == name)
            || FUNCTIONS.iter().any(|(f, ..)| *f == name)
    }
}

impl Check<'_> {
    /// The effect of an entry of kind `expression`.
    pub(crate) fn formula(&self, key: &str, entry: &EffectEntry) -> Result<AnyEffect<f64>, VehicleError> {
        self.known_keys(key, entry)?;
        let name = self.expression_name(key, entry)?;
        let (parameters, value) = self.declared(key, entry)?;
        let mut own =
            Own { parameters: parameters.iter().map(|p| p.freedom.name.clone()).collect(), ..Own::default() };
        let starts = self.remembered(key, entry, &mut own)?;
        let lets = self.lets(key, entry, &mut own)?;
        let mut memory = Vec::new();
        for (name, start, next) in starts {
            let next = self.program(&format!("{key}.memory.{name}.next"), next, &own)?;
            let start = Program::new(vec![Op::Literal(start)])
                .map_err(|e| self.wrong(key, "a start", e, "write a number"))?;
            memory.push(Memory { name, start, next });
        }
        let of = |param: &str| entry.params.get(param);
        let three = |param: &str| self.list::<3>(&join(key, param), of(param), &own, "x, y and z");
        let rotor_command = match of("rotor_command") {
            None => Vec::new(),
            Some(given) => self.rotor_commands(&join(key, "rotor_command"), given, &own)?,
        };
        let formula = Formula {
            name,
            lets,
            memory,
            force_body_n: three("force_body_n")?,
            force_world_n: three("force_world_n")?,
            torque_body_n_m: three("torque_body_n_m")?,
            thrust_factor: of("thrust_factor")
                .map(|v| self.program(&format!("{key}.thrust_factor"), v, &own))
                .transpose()?,
            rotor_command,
            attitude_command: self.list::<4>(
                &join(key, "attitude_command"),
                of("attitude_command"),
                &own,
                "roll, pitch, yaw and thrust",
            )?,
            controls: self.controls(key, entry)?,
            parameters,
        };
        self.makes_sense(key, &formula)?;
        self.flies_its_models(key, entry, &formula)?;
        Ok(AnyEffect::Expression(Params { value, formula: intern(formula) }))
    }

    fn known_keys(&self, key: &str, entry: &EffectEntry) -> Result<(), VehicleError> {
        for param in entry.params.keys() {
            if !DOES.iter().chain(&BESIDE).any(|known| known == param) {
                let expected = format!(
                    "one of kind, models, source, source_log_sha256, date, note, {}, {}",
                    BESIDE.join(", "),
                    DOES.join(", ")
                );
                return Err(self.wrong(
                    join(key, param),
                    &expected,
                    "an unknown key",
                    "correct or remove the key",
                ));
            }
        }
        if let Some(extra) = entry.sigma.keys().next() {
            return Err(self.wrong(
                format!("{key}.sigma.{extra}"),
                "the sigma of a parameter in the parameter's own table",
                "a sigma of the effect",
                "write sigma = { value = … } below [effect.parameter.NAME]",
            ));
        }
        if !DOES.iter().any(|k| entry.params.contains_key(*k)) {
            let expected = format!("at least one of {}", DOES.join(", "));
            return Err(self.wrong(key, &expected, "none", "write what the effect does"));
        }
        Ok(())
    }

    /// Names, starts and texts of what is remembered.
    fn remembered<'a>(
        &self,
        key: &str,
        entry: &'a EffectEntry,
        own: &mut Own,
    ) -> Result<Vec<(String, f64, &'a toml::Value)>, VehicleError> {
        let place = join(key, "memory");
        let Some(given) = entry.params.get("memory") else { return Ok(Vec::new()) };
        let Some(tables) = given.as_table() else {
            let (expected, found) = ("tables [effect.memory.NAME]", format!("a {}", given.type_str()));
            return Err(self.wrong(
                place,
                expected,
                found,
                "write one table per number, with start and next",
            ));
        };
        if tables.len() > MAX_MEMORY {
            let expected = format!("at most {MAX_MEMORY} numbers");
            return Err(self.wrong(place, &expected, tables.len(), "part the effect in two"));
        }
        let mut out = Vec::new();
        for (name, table) in tables {
            let place = join(&place, name);
            self.free_name(&place, name, own)?;
            let keys = |table: &toml::Table| table.keys().all(|k| matches!(k.as_str(), "start" | "next"));
            let parts = table.as_table().filter(|t| keys(t));
            let start = parts.map(|t| match t.get("start") {
                None => Some(0.0),
                Some(toml::Value::Float(v)) => Some(*v).filter(|v| v.is_finite()),
                Some(toml::Value::Integer(v)) => Some(*v as f64),
                Some(_) => None,
            });
            let (Some(Some(start)), Some(next)) = (start, parts.and_then(|t| t.get("next"))) else {
                let expected = "a finite number `start` (0 if absent) and an expression `next`";
                return Err(self.wrong(
                    place,
                    expected,
                    table,
                    "write e.g. { start = 0.0, next = \"low + dt * (vx - low) / 0.2\" }",
                ));
            };
            own.memory.push(name.clone());
            out.push((name.clone(), start, next));
        }
        Ok(out)
    }

    /// Values with names: texts `name = expression`, each of which may use those before it.
    fn lets(
        &self,
        key: &str,
        entry: &EffectEntry,
        own: &mut Own,
    ) -> Result<Vec<(String, Program)>, VehicleError> {
        let place = join(key, "let");
        let Some(given) = entry.params.get("let") else { return Ok(Vec::new()) };
        let remedy = "write e.g. let = [\"lean = sqrt(roll^2 + pitch^2)\"]";
        let Some(list) = given.as_array() else {
            return Err(self.wrong(
                place,
                "a list of texts `name = expression`",
                format!("a {}", given.type_str()),
                remedy,
            ));
        };
        if list.len() > MAX_LETS {
            return Err(self.wrong(
                place,
                &format!("at most {MAX_LETS} values"),
                list.len(),
                "part the effect in two",
            ));
        }
        let mut out = Vec::new();
        for (i, value) in list.iter().enumerate() {
            let place = format!("{place}.{i}");
            let parted = value.as_str().and_then(|text| text.split_once('='));
            let Some((name, text)) = parted else {
                return Err(self.wrong(place, "a text `name = expression`", value, remedy));
            };
            let name = name.trim();
            self.free_name(&place, name, own)?;
            let program = self.program(&place, &toml::Value::String(text.trim().into()), own)?;
            own.lets.push(name.into());
            out.push((name.into(), program));
        }
        Ok(out)
    }

    fn free_name(&self, place: &str, name: &str, own: &Own) -> Result<(), VehicleError> {
        if is_identifier(name) && !own.takes(name) {
            return Ok(());
        }
        let expected = "a name of letters, digits and underscores that nothing else has";
        Err(self.wrong(place, expected, format!("`{name}`"), "choose another name"))
    }

    fn controls(&self, key: &str, entry: &EffectEntry) -> Result<bool, VehicleError> {
        match entry.params.get("controls") {
            None => Ok(false),
            Some(toml::Value::Boolean(v)) => Ok(*v),
            Some(other) => {
                let remedy = "write controls = true for a controller in place of the on-board one";
                Err(self.wrong(join(key, "controls"), "true or false", other, remedy))
            }
        }
    }

    fn rotor_commands(
        &self,
        place: &str,
        given: &toml::Value,
        own: &Own,
    ) -> Result<Vec<Program>, VehicleError> {
        let n_rotors = self.rotors();
        let list = given.as_array().filter(|list| n_rotors.is_none_or(|n| list.len() == n));
        let Some(list) = list else {
            let found = match given.as_array() {
                Some(list) => format!("{} entries", list.len()),
                None => format!("a {}", given.type_str()),
            };
            let expected = match n_rotors {
                Some(n) => format!("{n} expressions, one for each rotor"),
                None => "a list of expressions, one for each rotor".into(),
            };
            return Err(self.wrong(place, &expected, found, "write as many as the vehicle has rotors"));
        };
        list.iter().enumerate().map(|(i, v)| self.program(&format!("{place}.{i}"), v, own)).collect()
    }

    /// A list of expressions; `None` where it is not given.
    fn list<const K: usize>(
        &self,
        place: &str,
        given: Option<&toml::Value>,
        own: &Own,
        what: &str,
    ) -> Result<Option<[Program; K]>, VehicleError> {
        let Some(given) = given else { return Ok(None) };
        let list = given.as_array().filter(|a| a.len() == K);
        let Some(list) = list else {
            let found = match given.as_array() {
                Some(a) => format!("{} entries", a.len()),
                None => format!("a {}", given.type_str()),
            };
            let number = if K == 3 { "three" } else { "four" };
            let expected = format!("{number} expressions, for {what}");
            let remedy =
                if K == 3 { "write e.g. [\"-k * vx_body\", \"0\", \"0\"]" } else { "write all four" };
            return Err(self.wrong(place, &expected, found, remedy));
        };
        let programs: Result<Vec<Program>, VehicleError> =
            list.iter().enumerate().map(|(i, v)| self.program(&format!("{place}.{i}"), v, own)).collect();
        Ok(programs?.try_into().ok())
    }

    fn program(&self, place: &str, text: &toml::Value, own: &Own) -> Result<Program, VehicleError> {
        let number = match text {
            toml::Value::Integer(v) => Some(v.to_string()),
            toml::Value::Float(v) => Some(v.to_string()),
            _ => None,
        };
        let Some(text) = text.as_str().or(number.as_deref()) else {
            let found = format!("a {}", text.type_str());
            return Err(self.wrong(place, "an expression in quotes", found, "write e.g. \"-k * vx_body\""));
        };
        let [parameters, memory, lets] = [&own.parameters, &own.memory, &own.lets]
            .map(|list| list.iter().map(String::as_str).collect::<Vec<_>>());
        let names = Names { parameters: &parameters, memory: &memory, lets: &lets, others: None };
        parse_with(text, names).map_err(|error| {
            self.wrong(
                place,
                &format!("{} at column {} of `{text}`", error.expected, error.column),
                error.found,
                "docs/effects/expression.md lists variables, functions and operators",
            )
        })
    }

    /// Refuses a controller of models that do not take its commands: nothing would command them.
    fn flies_its_models(
        &self,
        key: &str,
        entry: &EffectEntry,
        formula: &Formula,
    ) -> Result<(), VehicleError> {
        if !formula.controls {
            return Ok(());
        }
        let models = entry.models.as_deref();
        let takes = |model: &str| match model == DYNAMICS[0] {
            true => !formula.rotor_command.is_empty(),
            false => formula.attitude_command.is_some(),
        };
        let listed = |model: &&&str| models.is_none_or(|list| list.iter().any(|own| own == **model));
        let Some(without) = DYNAMICS.iter().filter(listed).find(|model| !takes(model)) else { return Ok(()) };
        let fits: Vec<String> =
            DYNAMICS.iter().filter(|model| takes(model)).map(|m| format!("\"{m}\"")).collect();
        Err(self.wrong(
            join(key, "models"),
            "models that take what the controller commands (rotor_command: first_principles; attitude_command: the others)",
            format!("{without} among them"),
            &format!("write models = [{}]", fits.join(", ")),
        ))
    }

    /// Refuses what is never used, forces that read what only commands know, and controllers that command nothing.
    fn makes_sense(&self, key: &str, formula: &Formula) -> Result<(), VehicleError> {
        for (i, declared) in formula.parameters.iter().enumerate() {
            if !formula.reads_input(Input::Parameter(i)) {
                let name = &declared.freedom.name;
                return Err(self.wrong(
                    format!("{key}.parameter.{name}"),
                    "a parameter that an expression of the effect uses",
                    "one that none uses",
                    "use it or remove its table",
                ));
            }
        }
        let once = formula.read_by_forces().into_iter().find_map(|input| match input {
            Input::Variable(i) if known(VARIABLES[i].name) == Known::OnceAStep => Some(VARIABLES[i].name),
            _ => None,
        });
        if let Some(name) = once {
            return Err(self.wrong(
                key,
                "forces, torques and factors of what is there at every instant",
                format!("`{name}`, which is known once a step"),
                "let a number of [effect.memory] remember it",
            ));
        }
        let commands = !formula.rotor_command.is_empty() || formula.attitude_command.is_some();
        if formula.controls && !commands {
            let expected = "rotor_command or attitude_command of a controller";
            return Err(self.wrong(key, expected, "controls = true alone", "write what it commands"));
        }
        Ok(())
    }
}
