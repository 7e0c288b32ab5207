//! The JavaScript that pages carry, taken from npm as published: what users and CI need of it is checked in, so that they need no node.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::python::Host;
use crate::run::{self, Result};

/// Folder of the checkout that is written.
pub const FOLDER: &str = "assets/page/vendor";
/// The table of what was written: SHA-256 and name, as `sha256sum` prints it. A test of `crates/page` compares it with the files.
const TABLE: &str = "SHA256SUMS";

/// What of three.js is taken; written by hand. It stands in the table, so that a change of it without this command is found.
const ENTRY: &str = "three_entry.js";

/// One package of npm, as its registry describes it.
struct Package {
    name: &'static str,
    version: &'static str,
    /// The file's name in the registry.
    file: &'static str,
    /// SHA-512 as npm's `dist.integrity` has it.
    sha512: &'static str,
}

const THREE: Package = Package {
    name: "three",
    version: "0.187.0",
    file: "three-0.187.0.tgz",
    sha512: "Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA==",
};
const UPLOT: Package = Package {
    name: "uplot",
    version: "1.6.32",
    file: "uplot-1.6.32.tgz",
    sha512: "KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw==",
};
/// The bundler, a program without dependencies, for each platform.
const ESBUILD: &[(&str, Package)] = &[
    (
        "x86_64",
        Package {
            name: "@esbuild/linux-x64",
            version: "0.28.0",
            file: "linux-x64-0.28.0.tgz",
            sha512: "us0dSb9iFxIi8srnpl931Nvs65it/Jd2a2K3qs7fz2WfGPHqzfzZTfec7oxZJRNPXPnNYZtanmRc4AL/JwVzHQ==",
        },
    ),
    (
        "aarch64",
        Package {
            name: "@esbuild/linux-arm64",
            version: "0.28.0",
            file: "linux-arm64-0.28.0.tgz",
            sha512: "RVyzfb3FWsGA55n6WY0MEIEPURL1FcbhFE6BffZEMEekfCzCIMtB5yyDcFnVbTnwk+CLAgTujmV/Lgvih56W+A==",
        },
    ),
];

/// Fetches one file, compares its SHA-512, and unpacks it: arguments are the address, the hash and the folder.
const FETCH: &str = "
import base64, hashlib, io, sys, tarfile, urllib.request
address, wanted, folder = sys.argv[1:]
held = urllib.request.urlopen(address, timeout=60).read()
found = base64.b64encode(hashlib.sha512(held).digest()).decode()
if found != wanted:
    sys.exit(f'{address}: SHA-512 is {found}, expected {wanted}')
tarfile.open(fileobj=io.BytesIO(held), mode='r:gz').extractall(folder)
";

/// Hashes of files, as `sha256sum` prints them: arguments are the folder and the names.
const SUMS: &str = "
import hashlib, pathlib, sys
for name in sys.argv[2:]:
    print(hashlib.sha256((pathlib.Path(sys.argv[1]) / name).read_bytes()).hexdigest() + '  ' + name)
";

/// Writes [`FOLDER`] anew from the packages.
pub fn run() -> Result {
    let host = Host::find()?;
    let work = run::root().join("target").join(format!("vendor-{}", std::process::id()));
    let done = write(&host, &work, &run::root().join(FOLDER));
    let _ = fs::remove_dir_all(&work);
    done
}

fn write(host: &Host, work: &Path, to: &Path) -> Result {
    let bundler = ESBUILD.iter().find(|(arch, _)| *arch == std::env::consts::ARCH);
    let (_, bundler) = bundler
        .filter(|_| std::env::consts::OS == "linux")
        .ok_or("the bundler is pinned for Linux on x86-64 and ARM64 only: run this on one of them")?;
    let three = fetch(host, work, &THREE)?;
    let uplot = fetch(host, work, &UPLOT)?;
    let esbuild = fetch(host, work, bundler)?.join("bin/esbuild");

    let entry = work.join(ENTRY);
    copy(&to.join(ENTRY), &entry)?;
    let bundle = work.join("three.js");
    let mut command = Command::new(&esbuild);
    command.current_dir(work).arg(&entry);
    command.args(["--bundle", "--minify", "--format=iife", "--global-name=THREE", "--target=es2022"]);
    command
        .args(["--legal-comments=none", "--log-level=warning"])
        .arg(format!("--outfile={}", bundle.display()));
    command.arg(format!("--banner:js=/* three.js {}, MIT licence, see three.LICENSE.txt */", THREE.version));
    run::check(&mut command)?;

    let files = [
        (bundle, "three.js"),
        (three.join("LICENSE"), "three.LICENSE.txt"),
        (uplot.join("dist/uPlot.iife.min.js"), "uPlot.js"),
        (uplot.join("dist/uPlot.min.css"), "uPlot.css"),
        (uplot.join("LICENSE"), "uPlot.LICENSE.txt"),
    ];
    for (from, name) in &files {
        copy(from, &to.join(name))?;
    }
    let names = files.map(|(_, name)| name);
    let sums = run::output(host.command(&["-c", SUMS]).arg(to).args(names).arg(ENTRY))?;
    let table = to.join(TABLE);
    fs::write(&table, sums).map_err(|e| format!("{}: {e}", table.display()))?;
    eprintln!("written: {} of {FOLDER}", names.join(", "));
    Ok(())
}

/// Puts a package where imports find it, and returns its folder.
fn fetch(host: &Host, work: &Path, package: &Package) -> Result<PathBuf> {
    let address = format!("https://registry.npmjs.org/{}/-/{}", package.name, package.file);
    eprintln!("fetching {} {}", package.name, package.version);
    let unpacked = work.join("unpacked").join(package.name);
    fs::create_dir_all(&unpacked).map_err(|e| format!("{}: {e}", unpacked.display()))?;
    run::output(host.command(&["-c", FETCH, &address, package.sha512]).arg(&unpacked))
        .map_err(|_| format!("{address} could not be taken; the reason stands above"))?;
    let place = work.join("node_modules").join(package.name);
    let parent = place.parent().unwrap_or(work);
    fs::create_dir_all(parent).map_err(|e| format!("{}: {e}", parent.display()))?;
    fs::rename(unpacked.join("package"), &place).map_err(|e| format!("{}: {e}", place.display()))?;
    Ok(place)
}

fn copy(from: &Path, to: &Path) -> Result {
    let bytes = fs::read(from).map_err(|e| format!("{}: {e}", from.display()))?;
    fs::write(to, bytes).map_err(|e| format!("{}: {e}", to.display()))
}
