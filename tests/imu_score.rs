use retroflex::fuse::FilterName;
use retroflex::imu_score;
use std::path::PathBuf;

fn files() -> Option<Vec<PathBuf>> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let dir = ["../shared/data/imu", "../../shared/data/imu"].iter().map(|p| root.join(p)).find(|p| p.is_dir())?;
    let mut v: Vec<PathBuf> = std::fs::read_dir(dir).ok()?.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.to_string_lossy().ends_with(".csv.gz")).collect();
    v.sort();
    Some(v)
}
#[test]
fn table() {
    let f = files().unwrap();
    let rows = imu_score::run(&f, None, true).unwrap();
    println!("{}", imu_score::table(&rows));
    let _ = FilterName::ALL;
}
