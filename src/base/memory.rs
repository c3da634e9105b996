//! What memory may be taken, asked before it is: an allocation that fails cannot be caught.
//!
//! The limit of a setting holds, and of what this machine has left at the moment (free memory and caches, the control group's
//! limit, that of the address space) three quarters.

use crate::error::{Error, Result};
use std::fmt::Display;

/// What is left, bytes; `None` where the system does not tell.
fn left() -> Option<u64> {
    [free(), group(), address_space()].into_iter().flatten().min()
}

/// A small file of the kernel's.
fn told(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok()
}

/// The number behind `key`, in bytes: kernels count in KiB.
fn kib(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(1024)
}

/// Of the machine.
fn free() -> Option<u64> {
    kib(&told("/proc/meminfo")?, "MemAvailable:")
}

/// Of the process's control group and those above it, versions 2 and 1 (cgroups(7)).
fn group() -> Option<u64> {
    let own = told("/proc/self/cgroup").unwrap_or_default();
    // 0::/path, and for version 1 4:memory:/path or 5:cpu,memory:/path
    let of = |is: &dyn Fn(&str) -> bool| {
        let mut lines = own.lines().filter_map(|line| line.split_once(':')?.1.split_once(':'));
        lines.find(|(controllers, _)| is(controllers)).map(|(_, path)| path.to_string())
    };
    let second = of(&str::is_empty).map(|path| ("/sys/fs/cgroup".to_string(), path, ["memory.max", "memory.current"]));
    let first = of(&|controllers| controllers.split(',').any(|one| one == "memory"))
        .map(|path| ("/sys/fs/cgroup/memory".to_string(), path, ["memory.limit_in_bytes", "memory.usage_in_bytes"]));
    second.into_iter().chain(first).filter_map(|(root, path, files)| least(&root, &path, files)).min()
}

/// The least that is left in a group or one above it. Pages of files that nobody reads are used, but given back when asked for.
fn least(root: &str, path: &str, [most, used]: [&str; 2]) -> Option<u64> {
    let number = |folder: &str, file: &str| told(&format!("{root}{folder}/{file}"))?.trim().parse::<u64>().ok();
    let cached = |folder: &str| {
        let text = told(&format!("{root}{folder}/memory.stat")).unwrap_or_default();
        let of = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.trim().parse::<u64>().ok());
        of("total_inactive_file ").or_else(|| of("inactive_file ")).unwrap_or(0)
    };
    let mut folder = path.trim_end_matches('/').to_string();
    let mut all = Vec::new();
    loop {
        let taken = number(&folder, used).unwrap_or(0).saturating_sub(cached(&folder));
        all.extend(number(&folder, most).map(|most| most.saturating_sub(taken)));
        match folder.rfind('/') {
            Some(end) => folder.truncate(end),
            None => return all.into_iter().min(),
        }
    }
}

/// Of the address space (`ulimit -v`).
fn address_space() -> Option<u64> {
    let limits = told("/proc/self/limits")?;
    let most = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    let most: u64 = most.split_whitespace().next()?.parse().ok()?;
    Some(most.saturating_sub(kib(&told("/proc/self/status")?, "VmSize:")?))
}

/// A batch of no environments.
pub fn none_asked(limit: u64) -> Error {
    let most = format!("1 to what {:.1} GiB hold", limit as f64 / f64::from(1 << 30));
    Error::limit("n_env", 0, most, "A batch has environments.")
}

/// A request for memory.
pub struct Request<'a, V> {
    /// What is asked for, and how much of it.
    pub what: &'a str,
    pub value: V,
    pub bytes: u128,
    /// Most bytes by the setting of this name.
    pub limit: u64,
    pub setting: &'a str,
    /// How to take less: "Step fewer environments at once".
    pub less: &'a str,
}

impl<V: Display> Request<'_, V> {
    /// Refuses what is beyond the setting or what is left; `most` tells what would fit into so many bytes.
    ///
    /// # Errors
    /// [`Error::Limit`].
    pub fn check(self, most: impl FnOnce(u64) -> String) -> Result<()> {
        self.check_with(left(), most)
    }

    fn check_with(self, left: Option<u64>, most: impl FnOnce(u64) -> String) -> Result<()> {
        let machine = left.map_or(u64::MAX, |left| left / 4 * 3);
        let limit = self.limit.min(machine);
        if self.bytes <= u128::from(limit) {
            return Ok(());
        }
        let gib = |bytes: f64| format!("{:.1} GiB", bytes / f64::from(1 << 30));
        let remedy = match left {
            Some(left) if machine < self.limit => {
                let left = gib(left as f64);
                format!("{}: this machine has {left} left, of which three quarters may be taken.", self.less)
            }
            _ => format!("{}, or raise {}.", self.less, self.setting),
        };
        let (most, size) = (most(limit), gib(limit as f64));
        let fits = if most.is_empty() { size } else { format!("{most} ({size})") };
        Err(Error::limit(self.what, format!("{} ({})", self.value, gib(self.bytes as f64)), fits, &remedy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(bytes: u128, left: Option<u64>) -> Result<()> {
        let request =
            Request { what: "n_env", value: 7, bytes, limit: 8 << 30, setting: "memory_limit", less: "Take fewer" };
        request.check_with(left, |bytes| format!("1 to {}", bytes >> 30))
    }

    #[test]
    fn the_smaller_of_the_setting_and_three_quarters_of_what_is_left_holds() {
        assert!(asked(6 << 30, Some(16 << 30)).is_ok());
        assert!(asked(8 << 30, None).is_ok());
        let text = asked(9 << 30, Some(64 << 30)).unwrap_err().to_string();
        assert_eq!(
            text,
            "n_env is 7 (9.0 GiB), over the limit of 1 to 8 (8.0 GiB). Take fewer, or raise memory_limit."
        );
        let text = asked(4 << 30, Some(4 << 30)).unwrap_err().to_string();
        assert_eq!(
            text,
            "n_env is 7 (4.0 GiB), over the limit of 1 to 3 (3.0 GiB). Take fewer: this machine has 4.0 GiB left, of which \
             three quarters may be taken."
        );
    }

    #[test]
    fn a_group_has_left_what_the_tightest_above_it_has_without_pages_that_are_given_back() {
        let root = tempfile::tempdir().unwrap();
        let file = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        let left = || least(root.path().to_str().unwrap(), "/a/b", ["memory.max", "memory.current"]);
        assert_eq!(left(), None);
        file("a/b/memory.max", "max\n");
        assert_eq!(left(), None);
        file("a/memory.max", "1000\n");
        file("a/memory.current", "900\n");
        assert_eq!(left(), Some(100));
        file("a/memory.stat", "anon 300\ninactive_file 600\nactive_file 0\n");
        assert_eq!(left(), Some(700));
        file("a/b/memory.max", "500\n");
        file("a/b/memory.current", "450\n");
        assert_eq!(left(), Some(50));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_machine_tells_what_is_left() {
        let left = left().unwrap();
        println!("left: {left} B (free {:?}, group {:?}, addresses {:?})", free(), group(), address_space());
        assert!((1 << 20..1 << 50).contains(&left), "{left}");
    }
}
