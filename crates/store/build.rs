//! Lists the changes of tables in `migrations/`, so that the program contains them.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let manifest = env::var("CARGO_MANIFEST_DIR").map_err(io::Error::other)?;
    let out = env::var("OUT_DIR").map_err(io::Error::other)?;
    let folder = Path::new(&manifest).join("../../migrations").canonicalize()?;
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut names = fs::read_dir(&folder)?
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect::<io::Result<Vec<String>>>()?;
    names.retain(|name| name != "schema");
    names.sort();
    let mut list = String::from("[\n");
    for name in names {
        let Some((version, _)) = name.strip_suffix(".sql").and_then(|name| name.split_once('_')) else {
            return Err(io::Error::other(format!("migrations/{name} is not called VERSION_DESCRIPTION.sql")));
        };
        let version: i64 = version.parse().map_err(io::Error::other)?;
        let path = folder.join(&name);
        writeln!(list, "({version}, include_str!({path:?})),").map_err(io::Error::other)?;
    }
    list.push(']');
    fs::write(Path::new(&out).join("migrations.rs"), list)
}
