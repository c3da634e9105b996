//! Groups of what is observed.

use omnidrones::tasks::{Env, EnvConfig, GroupKind, Spec};

fn spec(task: &str, text: &str) -> Spec {
    let config = EnvConfig { n_env: 1, ..EnvConfig::from_toml(text, "test").unwrap() };
    Env::make(task, &config).unwrap().spec().clone()
}

#[test]
fn groups_are_named_columns_of_the_arrays_that_are_there() {
    let plain = spec("Hover", "");
    assert_eq!(plain.groups().len(), 1);
    assert_eq!(plain.group("actor").unwrap().columns, 0..plain.n_observation);
    let text = "observation = [{ kind = 'history', steps = 3 }, { kind = 'privileged' }, { kind = 'normalise' }]\n\
                randomise = [{ what = 'mass', range = [0.7, 1.3] }]";
    let own = spec("Hover", text);
    let (history, known) = (own.group("history").unwrap(), own.privileged.len());
    assert_eq!((history.shape, history.columns), (vec![3, plain.n_observation], 0..3 * plain.n_observation));
    assert_eq!(own.n_observation, 3 * plain.n_observation + known);
    let privileged = own.group("privileged").unwrap();
    assert_eq!((privileged.kind, privileged.shape), (GroupKind::Privileged, vec![known]));
    assert!(known > 0);
    let (past, shown) = (own.group("past").unwrap(), own.group("parameters").unwrap());
    assert_eq!(
        (past.shape, past.columns),
        (vec![2, plain.n_observation], plain.n_observation..3 * plain.n_observation)
    );
    assert_eq!((shown.kind, shown.columns), (GroupKind::Actor, 3 * plain.n_observation..own.n_observation));
    assert!(spec("Hover", "observation = [{ kind = 'privileged' }]").group("parameters").is_err(), "nothing varies");
}

#[test]
fn a_field_is_a_group_of_its_own_shape_and_a_wrong_name_suggests_the_nearest() {
    let team = spec("Formation", "");
    let others = team.group("others").unwrap();
    let range = team.observation_range("others").unwrap();
    assert_eq!((others.shape[0], others.columns), (team.n_agent - 1, range.clone()));
    assert_eq!(others.shape.iter().product::<usize>(), range.len());
    let critic = team.group("critic").unwrap();
    assert_eq!((critic.kind, critic.columns), (GroupKind::Critic, 0..team.n_central));
    let told = team.group("otters").unwrap_err().to_string();
    assert!(told.contains("did you mean 'others'"), "{told}");
}
