//! Experiments only.
use std::collections::HashMap;
use std::sync::OnceLock;
/// A value.
pub fn get(name: &str, default: f64) -> f64 {
    static SET: OnceLock<HashMap<String, f64>> = OnceLock::new();
    let set = SET.get_or_init(|| {
        std::env::var("TUNE").unwrap_or_default().split(',').filter_map(|kv| kv.split_once('=')).map(|(k, v)| (k.to_owned(), v.parse().expect("number"))).collect()
    });
    if set.is_empty() { default } else { set.get(name).copied().unwrap_or(default) }
}
