"""Looks at the libraries of a folder: libraries.py FOLDER shipped|testing [--most-mb N]. What they need, export and how they are laid out."""
import pathlib, re, subprocess, sys
from stubs import read

SYSTEM = {"libc.so", "libm.so", "libdl.so", "liblog.so", "libandroid.so"}
OURS = "libboxline_jni.so"


def run(*command):
    return subprocess.run([*map(str, command)], check=True, capture_output=True, text=True).stdout


def natives(root, testing):
    """The names that Kotlin declares, as the system looks for them."""
    files = {"Native": root / "android/library/src/main/kotlin/dev/boxline/internal/Native.kt"}
    if testing:
        files["NativeTesting"] = root / "android/library/src/test/kotlin/dev/boxline/internal/NativeTesting.kt"
    return {f"Java_dev_boxline_internal_{name}_{method}"
            for name, path in files.items() for method in re.findall(r"external fun (\w+)\(", path.read_text())}


def main(folder, kind, *options):
    here = pathlib.Path(__file__).parent
    allowed = {name: weak for _, names in read(here / "imports.txt").values() for name, weak in names}
    problems = []
    folder = pathlib.Path(folder)
    shipped_here = {p.name for p in folder.glob("*.so")}
    for path in sorted(folder.glob("*.so")):
        dynamic, headers = run("llvm-readelf-22", "-d", path), run("llvm-readelf-22", "-lW", path)
        needed = set(re.findall(r"NEEDED.*\[(.*)\]", dynamic))
        problem = lambda text: problems.append(f"{path.name}: {text}")
        if needed - SYSTEM - shipped_here:
            problem(f"needs {needed - SYSTEM - shipped_here}")
        if f"[{path.name}]" not in "".join(re.findall(r"SONAME.*", dynamic)):
            problem("its SONAME is another")
        if "TEXTREL" in dynamic or re.search(r"^\s*TLS ", headers, re.M):
            problem("has text relocations or a TLS segment")
        for line in re.findall(r"^\s*LOAD .*", headers, re.M):
            if int(line.split()[-1], 16) < 0x4000:
                problem(f"a segment is aligned to {line.split()[-1]}, 0x4000 is needed")
        exported = {l.split()[-1].split("@")[0] for l in run("llvm-nm-22", "-D", "--defined-only", path).splitlines()}
        others = set().union(*({l.split()[-1] for l in run("llvm-nm-22", "-D", "--defined-only", p).splitlines()} for p in folder.glob("*.so")))
        for line in run("llvm-nm-22", "-D", "--undefined-only", path).splitlines():
            mark, name = line.split()[-2], line.split()[-1].split("@")[0]
            if name not in allowed and name not in others:
                problem(f"imports {name}, which imports.txt does not allow")
            elif allowed.get(name) and mark not in "wWvV":
                problem(f"imports {name}, which came after API 24, not weakly")
        if path.name == OURS:
            declared = natives(here.parent.parent, kind == "testing")
            if exported - declared:
                problem(f"exports without a declaration in Kotlin: {sorted(exported - declared)}")
            if declared - exported:
                problem(f"declared in Kotlin, not exported: {sorted(declared - exported)}")
        size = path.stat().st_size
        print(f"   {path.name} {size} bytes, needs {' '.join(sorted(needed))}")
        if "--most-mb" in options and size > float(options[options.index("--most-mb") + 1]) * 1e6:
            problem(f"{size} bytes is too much")
    for text in problems:
        print(f"   {text}")
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
