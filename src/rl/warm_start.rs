//! The weights of one policy as the first weights of another, which may see other things.
//!
//! A field of the new observation takes the columns of the old first layer that belong to the field of its name, number by
//! number; what the old policy did not see begins at weight 0. Where all that is new is such, the new policy acts at first
//! as the old one did. Look-ahead points begin with the present one, so a `path` takes the place of a `target`.

use super::nn::head::Head;
use super::nn::{Network, last_encoder};
use super::policy::{Actor, Policy};
use base::error::{Error, Result};
use tasks::{Env, ObservationTransform, Spec, Statistics};

/// What a learner begins with.
#[derive(Debug, Clone)]
pub struct WarmStart {
    /// Parameters of the network, one agent's after the other where each has its own; without those of the head that say how far the
    /// policy explores.
    pub parameters: Vec<f32>,
    /// Of a stage `normalise`, where the policy was trained behind one.
    pub statistics: Option<Statistics>,
}

/// Most observations that statistics from elsewhere count for: fields that are new must find their own soon.
const MOST_SEEN: f64 = 1e5;

/// Fields that stand for others at their first numbers.
const STANDS_FOR: [(&str, &str); 1] = [("path", "target")];

impl WarmStart {
    /// For an actor in environments like `spec`, from a policy that flew in those like `of`.
    ///
    /// # Errors
    /// [`Error::Value`] if hidden layers or actions differ, or if each of so many agents has a network there and not here.
    pub fn new(policy: &Policy, of: &Spec, actor: &Actor, spec: &Spec) -> Result<Self> {
        let columns = columns(of, spec, |name| name);
        let statistics = statistics(policy, of, spec)?;
        let (n_set, n_old) = (actor.n_set(), policy.actor().n_set());
        if n_old != 1 && n_old != n_set {
            let remedy = "Begin from a policy that agents share, or from one of as many agents with a network each.";
            return Err(Error::value(
                "number of networks of the policy to begin from",
                n_old,
                format!("1 or {n_set}"),
                remedy,
            ));
        }
        let own = (0..n_set).map(|k| policy.actor().set(policy.parameters(), k % n_old).0);
        let own = own.map(|own| network(&*policy.actor().mlp, own, &*actor.mlp, &columns));
        let parameters = own.collect::<Result<Vec<_>>>()?.concat();
        Ok(Self { parameters, statistics })
    }

    /// Random weights `parameters` with such last biases that an actor of continuous actions begins about the
    /// [safe command](Env::safe_command) of its agent, or where all share it, in each number, of the first agent that has it:
    /// episodes last longer from the first update on. Other actors begin as they are. A run that begins again takes the same
    /// weights.
    ///
    /// # Errors
    /// As `Network::from_parts`.
    pub fn at(actor: &Actor, parameters: &[f32], env: &Env) -> Result<Self> {
        let (spec, n) = (env.spec(), actor.n_action());
        let has = |agent: usize, k: usize| k < spec.n_action_of(agent);
        let who = |set: usize, k: usize| match actor.n_set() {
            1 => (0..spec.n_agent).find(|agent| has(*agent, k)).unwrap_or(0),
            _ => set,
        };
        let begin = |(set, parameters): (usize, &[f32])| {
            let command: Vec<f64> = (0..n).map(|k| env.safe_command()[who(set, k) * n + k]).collect();
            let parts = actor.mlp.parts(parameters);
            let last = parts.iter().rev().find(|part| part.name.ends_with(".bias") && part.shape == [command.len()]);
            let last = last.filter(|_| matches!(actor.head, Head::Gaussian { .. })).map(|part| part.name.clone());
            actor.mlp.from_parts(&mut |name, _| {
                if last.as_deref() == Some(name) {
                    return Ok(command.iter().map(|c| actor.mlp.bias_for(*c) as f32).collect());
                }
                Ok(parts.iter().find(|part| part.name == name).map(|part| part.data.clone()).unwrap_or_default())
            })
        };
        // random weights may come without the head's parameters
        let own = (0..actor.n_set()).map(|k| if k == 0 { parameters } else { actor.set(parameters, k).0 });
        let parameters = own.enumerate().map(begin).collect::<Result<Vec<_>>>()?.concat();
        Ok(Self { parameters, statistics: None })
    }

    /// As [`WarmStart::new`], but for the last encoder: it stays as it is among `random` weights of `actor`, and may read other
    /// things than the policy's, as long as it gives as many numbers. All else sees the same.
    ///
    /// # Errors
    /// As [`WarmStart::new`]; [`Error::Value`] for networks without encoders, and unless all but the last one is alike.
    pub fn but_for_the_last_encoder(
        policy: &Policy,
        of: &Spec,
        actor: &Actor,
        random: &[f32],
        spec: &Spec,
    ) -> Result<Self> {
        let columns = columns(of, spec, |name| name);
        let ((from, _), (to, last)) = (last_encoder(&*policy.actor().mlp)?, last_encoder(&*actor.mlp)?);
        if policy.actor().n_set() != 1 || !to.is_alike_but_for_the_last_encoder(from, |k| columns[k]) {
            let limit = "the same layers, activations and fields but for the last encoder, one policy for all agents";
            let remedy = "Teach by apg or shac, with the student's network.hidden and activation; let both observe alike but for a stage \
                          `privileged` of the teacher and a `history` of the student, and end both lists of encoders with as many units.";
            return Err(Error::value("policy of the teacher", "unlike the student's", limit, remedy));
        }
        let prefix = format!("encoder.{last}.");
        let (parts, fresh) = (from.parts(policy.parameters()), to.parts(random));
        let parameters = to.from_parts(&mut |name, shape| {
            let of = if name.starts_with(&prefix) { &fresh } else { &parts };
            let own = of.iter().find(|part| part.name == name && part.shape == shape);
            // alike networks have the same parts
            Ok(own.map(|part| part.data.clone()).unwrap_or_default())
        })?;
        Ok(Self { parameters, statistics: statistics(policy, of, spec)? })
    }

    /// Whether it fits an actor.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of weights.
    pub(crate) fn check(&self, actor: &Actor) -> Result<()> {
        let (got, wanted) = (self.parameters.len(), actor.n_set() * actor.mlp.n_parameter());
        if got == wanted {
            return Ok(());
        }
        let remedy = "Make them for this actor: WarmStart::new.";
        Err(Error::value("weights to begin with", got, wanted.to_string(), remedy))
    }
}

/// Statistics of a policy's normaliser, for the fields of `spec` that it knows.
///
/// # Errors
/// [`Error::Value`] unless both observations are normalised last, or neither is.
fn statistics(policy: &Policy, of: &Spec, spec: &Spec) -> Result<Option<Statistics>> {
    let normalised =
        |spec: &Spec| spec.config.observation.iter().any(|s| matches!(s, ObservationTransform::Normalise { .. }));
    let width = policy.statistics().map_or(of.n_observation, |s| s.mean.len());
    if normalised(of) != normalised(spec) || width != of.n_observation {
        let limit = "normalised in both runs or in neither, as the last stage";
        let remedy = "Begin from a run whose policy saw its observations as this one does, or leave `from` out.";
        return Err(Error::value("observation of the policy to begin from", "on another scale", limit, remedy));
    }
    // what was seen before is of the scale of what is seen now
    let of_scale = columns(of, spec, newest);
    Ok(policy.statistics().map(|s| Statistics {
        count: s.count.min(MOST_SEEN),
        mean: of_scale.iter().map(|c| c.map_or(0.0, |k| s.mean[k])).collect(),
        variance: of_scale.iter().map(|c| c.map_or(1.0, |k| s.variance[k])).collect(),
    }))
}

/// `velocity` of `velocity_3_ago`.
fn newest(name: &str) -> &str {
    let before = name.strip_suffix("_ago").and_then(|name| name.rsplit_once('_'));
    before.filter(|(_, steps)| steps.parse::<usize>().is_ok()).map_or(name, |(newest, _)| newest)
}

/// For every number of `spec`'s observation its place in that of `of`, if it has one: by the field's name, else by what `known` makes
/// of it.
fn columns(of: &Spec, spec: &Spec, known: fn(&str) -> &str) -> Vec<Option<usize>> {
    let mut columns = Vec::with_capacity(spec.n_observation);
    for field in &spec.observation {
        let known = known(&field.name);
        let stands_for = STANDS_FOR.iter().find(|(new, _)| *new == known).map(|(_, old)| *old);
        let names = [Some(&*field.name), Some(known), stands_for];
        let old = names.into_iter().flatten().find_map(|name| of.observation_range(name));
        columns.extend((0..field.size).map(|k| old.clone().and_then(|range| range.clone().nth(k))));
    }
    columns
}

/// The parameters of `to` with those of `from` behind the first layer, whose columns come from `columns`. Where something
/// stands before the hidden layers, all must be alike.
fn network(from: &dyn Network, parameters: &[f32], to: &dyn Network, columns: &[Option<usize>]) -> Result<Vec<f32>> {
    let (Some(from), Some(to)) = (from.as_mlp(), to.as_mlp()) else {
        return alike(from, parameters, to, columns);
    };
    let (got, wanted) = (from.activation(), to.activation());
    if got != wanted {
        let remedy = "Give both policies the same network.activation.";
        let what = "activation of the policy to begin from";
        return Err(Error::value(what, format!("{got:?}"), format!("{wanted:?}, as the new one's"), remedy));
    }
    let parts = from.parts(parameters);
    let n_old = from.n_input();
    to.from_parts(|name, shape| {
        let own = parts.iter().find(|part| part.name == name);
        let own = own.filter(|part| name == "0.weight" && part.shape[0] == shape[0] || part.shape == shape);
        let Some(own) = own else {
            let got = parts.iter().find(|part| part.name == name).map_or("none".into(), |p| format!("{:?}", p.shape));
            let remedy = "Give both policies the same hidden layers, and vehicles with as many commands.";
            return Err(Error::value(format!("{name} of the policy to begin from"), got, format!("{shape:?}"), remedy));
        };
        if name != "0.weight" {
            return Ok(own.data.clone());
        }
        let value = |o: usize, c: &Option<usize>| c.map_or(0.0, |k| own.data[o * n_old + k]);
        Ok((0..shape[0]).flat_map(|o| columns.iter().map(move |c| (o, c))).map(|(o, c)| value(o, c)).collect())
    })
}

/// The parameters of a network of the same parts that sees the same numbers.
fn alike(from: &dyn Network, parameters: &[f32], to: &dyn Network, columns: &[Option<usize>]) -> Result<Vec<f32>> {
    let same = columns.iter().enumerate().all(|(k, column)| *column == Some(k));
    if from.slots() != to.slots() || from.n_input() != to.n_input() || !same {
        let (got, limit) = ("another one, or of another observation", "of the same encoders, memory and observation");
        let remedy = "Begin from a policy of the same settings, or leave `from` out.";
        return Err(Error::value("network of the policy to begin from", got, limit, remedy));
    }
    Ok(parameters[..from.n_parameter()].to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Layers};
    use rng::{Purpose, Stream};
    use tasks::EnvConfig;

    fn spec(task: &str, config: &EnvConfig) -> Spec {
        Env::make(task, &EnvConfig { n_env: 1, ..config.clone() }).unwrap().spec().clone()
    }

    fn random(spec: &Spec, hidden: &[usize], statistics: Option<Statistics>) -> Policy {
        let actor = Actor::new(spec, &Layers { hidden: hidden.into(), ..Layers::default() }, true).unwrap();
        let mut parameters = actor.mlp.init(&mut Stream::new(3, 0, 0, Purpose::LEARNING));
        parameters.resize(actor.n_parameter(), -0.7);
        Policy::new(actor, parameters, statistics, spec).unwrap()
    }

    #[test]
    fn weights_about_the_safe_command_hold_the_weight_where_nothing_is_seen() {
        for squashed in [true, false] {
            let env = Env::make("Hover", &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
            let actor = Actor::new(env.spec(), &Layers::default(), squashed).unwrap();
            let mut parameters = actor.mlp.init(&mut Stream::new(3, 0, 0, Purpose::LEARNING));
            let start = WarmStart::at(&actor, &parameters, &env).unwrap();
            parameters.clone_from(&start.parameters);
            parameters.resize(actor.n_parameter(), -0.5);
            let mut policy = Policy::new(actor, parameters, None, env.spec()).unwrap();
            let mut actions = [0.0; 4];
            policy.act(&vec![0.0; env.spec().n_observation], &mut actions).unwrap();
            let off = actions.iter().zip(env.safe_command()).map(|(a, b)| (f64::from(*a) - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-6, "{actions:?}"); // measured at most 3e-8
        }
    }

    #[test]
    fn a_policy_that_sees_more_acts_at_first_as_the_one_that_it_begins_from() {
        let config = EnvConfig::default();
        let (hover, track) = (spec("Hover", &config), spec("Track", &config));
        let mut old = random(&hover, &[16, 8], None);
        let actor = Actor::new(&track, &Layers { hidden: vec![16, 8], ..Layers::default() }, true).unwrap();
        let start = WarmStart::new(&old, &hover, &actor, &track).unwrap();
        let mut parameters = start.parameters;
        parameters.resize(actor.n_parameter(), 0.0);
        let mut new = Policy::new(actor, parameters, None, &track).unwrap();
        let mut seen = vec![0.0; track.n_observation];
        seen.iter_mut().enumerate().for_each(|(i, x)| *x = 0.1 * (i as f32 + 1.0).sin());
        let mut less = vec![0.0; hover.n_observation];
        for field in &hover.observation {
            let place = hover.observation_range(&field.name).unwrap();
            let name = if field.name == "target" { "path" } else { &field.name };
            if let Some(own) = track.observation_range(name) {
                less[place.clone()].copy_from_slice(&seen[own][..place.len()]);
            }
        }
        let (mut then, mut now) = ([0.0; 4], [0.0; 4]);
        old.act(&less, &mut then).unwrap();
        new.act(&seen, &mut now).unwrap();
        // the same products, added up in another order
        then.iter().zip(now).for_each(|(a, b)| assert!((a - b).abs() < 1e-6, "{a} {b}"));
        assert!(then.iter().any(|a| a.abs() > 1e-3));
    }

    #[test]
    fn statistics_go_along_and_count_for_less() {
        let config =
            EnvConfig { observation: vec![ObservationTransform::Normalise { clip: 10.0 }], ..EnvConfig::default() };
        let (hover, track) = (spec("Hover", &config), spec("Track", &config));
        let n = hover.n_observation;
        let known = Statistics { count: 1e9, mean: vec![0.5; n], variance: vec![4.0; n] };
        let old = random(&hover, &[8], Some(known));
        let actor = Actor::new(&track, &Layers { hidden: vec![8], ..Layers::default() }, false).unwrap();
        let own = WarmStart::new(&old, &hover, &actor, &track).unwrap().statistics.unwrap();
        assert_eq!((own.count, own.mean.len()), (MOST_SEEN, track.n_observation));
        let path = track.observation_range("path").unwrap();
        assert_eq!(
            (&own.mean[path.clone()][..4], &own.variance[path][..4]),
            (&[0.5, 0.5, 0.5, 0.0][..], &[4.0, 4.0, 4.0, 1.0][..])
        );
    }

    #[test]
    fn what_was_seen_before_takes_the_scale_of_what_is_seen_now_unless_it_has_one() {
        let spec = |steps: Option<usize>| {
            let history = steps.map(|steps| ObservationTransform::History { steps });
            let observation = history.into_iter().chain([ObservationTransform::Normalise { clip: 10.0 }]).collect();
            spec("Hover", &EnvConfig { observation, ..EnvConfig::default() })
        };
        let (plain, two, three) = (spec(None), spec(Some(2)), spec(Some(3)));
        let counting = |n: usize| (0..n).map(|k| k as f64).collect::<Vec<_>>();
        let n = plain.n_observation;
        let from = |of: &Spec| {
            let all = of.n_observation;
            let known = Statistics { count: 1e3, mean: counting(all), variance: vec![1.0; all] };
            statistics(&random(of, &[8], Some(known)), of, &three).unwrap().unwrap().mean
        };
        assert_eq!(from(&plain), [counting(n), counting(n), counting(n)].concat());
        assert_eq!(from(&two), [counting(2 * n), counting(n)].concat());
    }

    #[test]
    fn other_layers_and_other_commands_are_refused_with_the_remedy() {
        let config = EnvConfig::default();
        let (hover, track) = (spec("Hover", &config), spec("Track", &config));
        let old = random(&hover, &[16, 8], None);
        let actor = Actor::new(&track, &Layers { hidden: vec![16, 9], ..Layers::default() }, true).unwrap();
        let error = WarmStart::new(&old, &hover, &actor, &track).unwrap_err().to_string();
        assert!(error.contains("the same hidden layers"), "{error}");
        let elu = Layers { hidden: vec![16, 8], activation: Activation::Elu, ..Layers::default() };
        let actor = Actor::new(&track, &elu, true).unwrap();
        let error = WarmStart::new(&old, &hover, &actor, &track).unwrap_err().to_string();
        assert!(error.contains("is Tanh, but it must be Elu"), "{error}");
        let omav = spec("OmavHover", &config);
        let actor = Actor::new(&omav, &Layers { hidden: vec![16, 8], ..Layers::default() }, true).unwrap();
        assert!(WarmStart::new(&old, &hover, &actor, &omav).is_err());
        let scaled =
            spec("Track", &EnvConfig { observation: vec![ObservationTransform::Normalise { clip: 10.0 }], ..config });
        let actor = Actor::new(&scaled, &Layers { hidden: vec![16, 8], ..Layers::default() }, true).unwrap();
        let error = WarmStart::new(&old, &hover, &actor, &scaled).unwrap_err().to_string();
        assert!(error.contains("normalised in both runs or in neither"), "{error}");
    }
}
