pub mod ground_effect;
