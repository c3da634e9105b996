//! In which settings two runs, or two kinds of environments, differ.

use std::collections::{BTreeMap, BTreeSet};
use toml::{Table, Value};

/// A setting that two runs or two kinds of environments do not share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigDifference {
    /// `apg.horizon`.
    pub key: String,
    /// As in a file; none where the key is absent: a setting of the task is then the task's own.
    pub then: Option<String>,
    /// Its value now, likewise.
    pub now: Option<String>,
}

/// Most differences in a message.
const MAX_DESCRIBED: usize = 5;

/// `apg.max_grad_norm is 0.1, was 0.5; …`, the first few and how many more there are.
pub(crate) fn described(differences: &[ConfigDifference]) -> String {
    let one = |d: &ConfigDifference| {
        let of_task = d.key.strip_prefix("env.").unwrap_or(&d.key).starts_with("task.");
        let absent = if of_task { "the task's own" } else { "none" };
        let said = |value: &Option<String>| value.clone().unwrap_or_else(|| absent.into());
        format!("{} is {}, was {}", d.key, said(&d.now), said(&d.then))
    };
    let mut parts: Vec<String> = differences.iter().take(MAX_DESCRIBED).map(one).collect();
    if differences.len() > MAX_DESCRIBED {
        parts.push(format!("and {} more", differences.len() - MAX_DESCRIBED));
    }
    parts.join("; ")
}

/// Between two tables, key by key; a table with a `kind` is one value.
pub(crate) fn config_diff(then: &Table, now: &Table) -> Vec<ConfigDifference> {
    let (then, now) = (leaves(then), leaves(now));
    let keys: BTreeSet<&String> = then.keys().chain(now.keys()).collect();
    let difference =
        |key: &String| ConfigDifference { key: key.clone(), then: then.get(key).cloned(), now: now.get(key).cloned() };
    keys.into_iter().map(difference).filter(|d| d.then != d.now).collect()
}

/// The values of a table by their dotted keys.
fn leaves(table: &Table) -> BTreeMap<String, String> {
    let mut all = BTreeMap::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) if !inner.contains_key("kind") => {
                all.extend(leaves(inner).into_iter().map(|(rest, value)| (format!("{key}.{rest}"), value)));
            }
            value => drop(all.insert(key.clone(), value.to_string())),
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn between(then: &str, now: &str) -> Vec<ConfigDifference> {
        config_diff(&then.parse().unwrap(), &now.parse().unwrap())
    }

    #[test]
    fn settings_are_named_by_their_keys_and_only_a_task_has_its_own() {
        let (then, now) =
            ("seed = 1\n[apg]\nmax_grad_norm = 0.5", "seed = 1\ntask.horizon = 9\n[env]\ntask.vehicle = 'iris'");
        let wanted = "apg.max_grad_norm is none, was 0.5; env.task.vehicle is \"iris\", was the task's own; \
                      task.horizon is 9, was the task's own";
        assert_eq!(described(&between(then, now)), wanted);
        assert_eq!(described(&between("ppo.target_kl = 0.01", "")), "ppo.target_kl is none, was 0.01");
        assert_eq!(between(then, then), []);
    }

    #[test]
    fn a_table_with_a_kind_is_one_value() {
        let all = between("rate = { kind = 'constant', value = 1.0 }", "rate = { kind = 'linear', from = 1.0 }");
        assert_eq!(all.iter().map(|d| d.key.as_str()).collect::<Vec<_>>(), ["rate"]);
    }

    #[test]
    fn the_first_few_are_told_and_how_many_more_there_are() {
        let all = between("", "a = 1\nb = 1\nc = 1\nd = 1\ne = 1\nf = 1\ng = 1");
        assert!(described(&all).ends_with("e is 1, was none; and 2 more"));
    }
}
