//! What a checkpoint says of itself: a text for people, sealed by its own SHA-256.

use super::damaged;
use super::disk::{Entry, hex};
use autodiff::native;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Number of the format on disk. Raised with every change but new names.
pub const FORMAT: u32 = 1;

with_defaults! {
    /// What a checkpoint is of. Fill in what is yours and take the rest from [`Manifest::default`].
    ///
    /// Times and the figures in `extra` are for readers: JSON may round the last bit of a fraction. What has to come back
    /// to the bit belongs in a tensor.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Manifest {
        /// [`FORMAT`]; set when saving.
        pub format: u32 = FORMAT,
        /// Version of the library; set when saving.
        pub version: String = env!("CARGO_PKG_VERSION").into(),
        /// What the processor computed with ([`instructions`](native::instructions)), the instruction set first; set when saving.
        /// Another set may round sums elsewhere; whether programs are interpreted changes no bit.
        pub instructions: String = native::instructions(),
        /// Name of the algorithm.
        pub algorithm: String = String::new(),
        /// Name of the task.
        pub task: String = String::new(),
        /// [`Spec::hash`](tasks::Spec::hash) of the environments: a policy fits others of equal hash. Sixteen
        /// hexadecimal digits in the file.
        #[serde(with = "sixteen_digits")]
        pub spec_hash: u64 = 0,
        /// The run's whole configuration, TOML.
        pub config: String = String::new(),
        /// Seed of the run.
        pub seed: u64 = 0,
        /// Updates of the policy done; names the checkpoint's folder.
        pub update: u64 = 0,
        /// Steps of all environments done.
        pub env_steps: u64 = 0,
        /// Time spent training, s.
        pub seconds: f64 = 0.0,
        /// Anything else worth reading, as figures of an evaluation.
        pub extra: serde_json::Map<String, serde_json::Value> = serde_json::Map::new(),
        /// Sizes and hashes of the files; set when saving.
        pub files: Files = Files::default(),
    }
}

/// The files beside the manifest.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Files {
    /// Of the weights.
    #[serde(rename = "policy.safetensors")]
    pub policy: Entry,
    /// Of everything else.
    #[serde(rename = "state.safetensors")]
    pub state: Entry,
}

mod sixteen_digits {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(hash: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{hash:016x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        let text = String::deserialize(deserializer)?;
        let hash = u64::from_str_radix(&text, 16).ok().filter(|hash| format!("{hash:016x}") == text);
        hash.ok_or_else(|| D::Error::custom("spec_hash must be sixteen hexadecimal digits, as 00f1e2d3c4b5a697"))
    }
}

// the sealed text is that of the manifest with one more line, over all that stands before it
const BEFORE_SEAL: &str = ",\n  \"sha256\": \"";
const AFTER_SEAL: &str = "\"\n}\n";
const END: &str = "\n}";

impl Manifest {
    /// The text of `manifest.json`, with the seal as its last key.
    pub(super) fn seal(&self, path: &Path) -> Result<String> {
        if !(self.seconds.is_finite() && self.seconds >= 0.0) {
            let remedy = "Give the time spent training.";
            return Err(Error::value("seconds of the manifest", self.seconds, "finite and ≥ 0", remedy));
        }
        let mut text = serde_json::to_string_pretty(self).map_err(|e| damaged(path, "the manifest", e.to_string()))?;
        text.truncate(text.len() - END.len());
        let seal = hex(&Sha256::digest(&text));
        Ok(text + BEFORE_SEAL + &seal + AFTER_SEAL)
    }

    /// The manifest of a sealed text. Every byte of the text counts.
    pub(super) fn unseal(text: &[u8], path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Peek {
            format: u64,
        }
        // before the seal, so that other formats may seal otherwise
        if let Ok(Peek { format }) = serde_json::from_slice(text)
            && format != u64::from(FORMAT)
        {
            return Err(Error::Format {
                file: path.display().to_string(),
                place: "format".into(),
                rule: format!("it is {format}, and this version ({}) reads {FORMAT}", env!("CARGO_PKG_VERSION")),
                remedy: "Load it with the version that the manifest names.".into(),
            });
        }
        let tail = BEFORE_SEAL.len() + 64 + AFTER_SEAL.len();
        let Some((body, seal)) = text.len().checked_sub(tail).and_then(|at| text.split_at_checked(at)) else {
            return Err(damaged(path, "the end of the text", "its SHA-256 is missing"));
        };
        let computed = [BEFORE_SEAL, &hex(&Sha256::digest(body)), AFTER_SEAL].concat();
        if seal != computed.as_bytes() {
            return Err(damaged(path, "the whole text", "it does not match the SHA-256 at its end"));
        }
        let whole = [body, END.as_bytes()].concat();
        serde_json::from_slice(&whole)
            .map_err(|e| damaged(path, format!("line {}, column {}", e.line(), e.column()), e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        let extra = serde_json::json!({"success": 0.5, "nested": {"a": [1, null, "ü"]}});
        Manifest {
            algorithm: "ppo".into(),
            task: "hover".into(),
            spec_hash: 0x00f1_e2d3_c4b5_a697,
            config: "[env]\nn = 64 # \"quoted\"\n".into(),
            seed: u64::MAX,
            update: 120,
            env_steps: 1 << 60,
            seconds: 12.5,
            extra: extra.as_object().unwrap().clone(),
            ..Manifest::default()
        }
    }

    #[test]
    fn a_sealed_text_is_json_and_gives_the_manifest_back() {
        let path = Path::new("manifest.json");
        let text = manifest().seal(path).unwrap();
        assert_eq!(Manifest::unseal(text.as_bytes(), path).unwrap(), manifest());
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["spec_hash"], "00f1e2d3c4b5a697");
        assert_eq!(json["sha256"].as_str().unwrap().len(), 64);
    }

    #[test]
    fn every_changed_missing_or_added_byte_breaks_the_seal() {
        let path = Path::new("manifest.json");
        let text = manifest().seal(path).unwrap().into_bytes();
        for at in 0..text.len() {
            for bit in 0..8 {
                let mut other = text.clone();
                other[at] ^= 1 << bit;
                assert!(Manifest::unseal(&other, path).is_err(), "byte {at}, bit {bit}");
            }
            assert!(Manifest::unseal(&text[..at], path).is_err(), "the first {at} bytes");
        }
        assert!(Manifest::unseal(&[&text[..], b"\n"].concat(), path).is_err());
        assert!(Manifest::unseal(&[b" ", &text[..]].concat(), path).is_err());
    }

    /// Text with a valid seal whose body is that of `manifest` after `edit`.
    fn forged(edit: impl Fn(String) -> String) -> Result<Manifest> {
        let path = Path::new("manifest.json");
        let text = manifest().seal(path).unwrap();
        let body = edit(text[..text.len() - BEFORE_SEAL.len() - 64 - AFTER_SEAL.len()].to_string());
        let seal = hex(&Sha256::digest(&body));
        Manifest::unseal((body + BEFORE_SEAL + &seal + AFTER_SEAL).as_bytes(), path)
    }

    #[test]
    fn a_sealed_text_with_unknown_missing_or_doubled_keys_or_another_format_is_refused() {
        assert_eq!(forged(|text| text).unwrap(), manifest());
        let cases = [
            ("\"format\": 1", "\"format\": 0", "it is 0, and this version"),
            ("\"format\": 1", "\"format\": 2", "it is 2, and this version"),
            ("\"format\": 1", "\"format\": -1", "invalid value"),
            ("\"seed\": ", "\"sead\": ", "unknown field `sead`"),
            ("\"seed\": ", "\"update\": 120,\n  \"seed\": ", "duplicate field `update`"),
            ("\"update\": 120", "\"update\": 1e300", "invalid type"),
            ("00f1e2d3c4b5a697", "f1e2d3c4b5a697", "sixteen hexadecimal digits"),
            ("00f1e2d3c4b5a697", "+0f1e2d3c4b5a697", "sixteen hexadecimal digits"),
            ("\"extra\": {", "\"extra\": 3, \"x\": {", "invalid type"),
            ("\"state.safetensors\"", "\"../../state\"", "unknown field"),
        ];
        for (from, to, wanted) in cases {
            let text = forged(|text| text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(text.contains(wanted), "{from} -> {to}: {text}");
        }
        let deep = forged(|text| text.replacen("\"nested\": {", &format!("\"x\": {}", "[".repeat(100_000)), 1));
        assert!(deep.unwrap_err().to_string().contains("recursion limit"));
    }

    #[test]
    fn a_manifest_says_how_programs_ran_and_those_that_name_the_set_alone_are_read() {
        let own = native::instructions();
        assert_eq!(Manifest::default().instructions, own);
        let told = format!("\"instructions\": \"{own}\"");
        for set in ["avx2", "avx512", "neon", "scalar"] {
            let old = forged(|text| text.replacen(&told, &format!("\"instructions\": \"{set}\""), 1)).unwrap();
            assert_eq!(old, Manifest { instructions: set.into(), ..manifest() });
        }
    }

    #[test]
    fn a_time_that_is_no_time_is_not_saved() {
        for seconds in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(Manifest { seconds, ..manifest() }.seal(Path::new("m")).is_err());
        }
    }
}
