"""What can be checked without Gradle: static.py ROOT. Versions, permissions, keep rules, natives, and the scripts' syntax."""
import pathlib, re, subprocess, sys, tempfile


def main(root):
    root, here = pathlib.Path(root), pathlib.Path(__file__).parent
    android, problems = root / "android", []
    check = lambda good, text: good or problems.append(text)
    library, sample = (android / m / "build.gradle.kts" for m in ("library", "sample"))
    text = {p: p.read_text() for p in (library, sample, android / "settings.gradle.kts", android / "build.gradle.kts")}

    cargo = re.search(r'^version = "(.*)"', (root / "Cargo.toml").read_text(), re.M)[1]
    properties = dict(line.split("=", 1) for line in (android / "gradle.properties").read_text().splitlines() if "=" in line)
    check(properties.get("boxline.version") == cargo, f"boxline.version is {properties.get('boxline.version')}, Cargo.toml has {cargo}")
    for path in (library, sample):
        check("minSdk = 24" in text[path], f"{path}: minSdk 24 is missing")
        manifest = (path.parent / "src/main/AndroidManifest.xml").read_text()
        check('minSdkVersion="24"' in manifest, f"{path.parent}: the manifest has another minSdkVersion")
        package = re.search(r'package="([\w.]+)"', manifest)[1]
        check(f'namespace = "{package}"' in text[path], f"{path}: the namespace is not {package}")
        check("permission.INTERNET" not in manifest, f"{path.parent}: asks for the internet")
    check('groupId = "dev.boxline"' in text[library] and 'artifactId = "boxline-android"' in text[library], "the coordinates are others")
    for abi in ("arm64-v8a", "armeabi-v7a", "x86_64"):
        check(f'"{abi}"' in text[library], f"{library}: no {abi}")

    # Exceptions that Rust makes by name: each is a class with that constructor and has a keep rule.
    guard = (root / "rust/jni/src/guard.rs").read_text()
    keep = (android / "library/keep.pro").read_text()
    exceptions = (android / "library/src/main/kotlin/dev/boxline/Exceptions.kt").read_text()
    for name in sorted(set(re.findall(r'jni_str!\("dev/boxline/(\w+)"\)', guard))):
        check(re.search(rf"class {name}\b", exceptions), f"{name}: no such class")
        check(re.search(rf"-keep class dev\.boxline\.{name} ", keep), f"{name}: no keep rule")
    for name in re.findall(r"-keep class dev\.boxline\.(\w+)", keep):
        check(name in exceptions, f"keep.pro: {name} is no class")
    # Natives: what Kotlin declares and what Rust exports, both ways (the built library is looked at too).
    rust = (root / "rust/jni/src/natives.rs").read_text()
    exported = {re.sub(r"_(\w)", lambda m: m[1].upper(), n) for n in re.findall(r'internal\.Native"\)\]\s+pub extern "system" fn (\w+)', rust)}
    declared = set(re.findall(r"external fun (\w+)\(", (android / "library/src/main/kotlin/dev/boxline/internal/Native.kt").read_text()))
    check(exported == declared, f"natives differ: {sorted(exported ^ declared)}")
    # The part without Android stays without.
    for path in (android / "library/src/main/kotlin/dev/boxline").glob("*.kt"):
        check(not re.search(r"^import android", path.read_text(), re.M), f"{path}: imports android; that belongs into usb/ or intent/")
    # Every language has every string.
    names = lambda d: set(re.findall(r'name="(\w+)"', (android / "sample/src/main/res" / d / "strings.xml").read_text())) - {"app_name"}
    for language in ("values-de", "values-zh"):
        check(names(language) == names("values"), f"{language}: {sorted(names(language) ^ names('values'))}")
    for file, array in (("Reason", "reasons"), ("Warning", "warnings")):
        kinds = len(re.findall(r"^        [A-Z_]+,$", (android / f"library/src/main/kotlin/dev/boxline/{file}.kt").read_text(), re.M))
        for language in ("values", "values-de", "values-zh"):
            strings = (android / "sample/src/main/res" / language / "strings.xml").read_text()
            words = re.search(rf'<string-array name="{array}">(.*?)</string-array>', strings, re.S)[1].count("<item>")
            check(words == kinds, f"{language}: {words} {array}, {file}.Kind has {kinds}")

    # Gradle's scripts as bodies of functions: names that only Gradle knows are unresolved here, which is expected; a script that
    # Kotlin cannot read is a syntax error.
    with tempfile.TemporaryDirectory() as folder:
        for number, (path, script) in enumerate(text.items()):
            imports = "".join(re.findall(r"^import .*\n", script, re.M))
            body = re.sub(r"^import .*\n", "", script, flags=re.M)
            (pathlib.Path(folder) / f"{path.parent.name}_{path.name.split('.')[0]}.kt").write_text(f"{imports}fun script{number}() {{\n{body}\n}}\n")
        said = subprocess.run([here / "kotlin", "scripts", folder], capture_output=True, text=True).stdout
        wrong = [line for line in said.splitlines() if re.search("syntax error|expecting", line, re.I)]
        check("unresolved reference" in said, "Gradle's scripts were not compiled: " + said)
        check(not wrong, "; ".join(wrong))
    for problem in problems:
        print(f"   {problem}")
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
