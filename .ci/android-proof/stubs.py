"""Stub libraries from imports.txt: stubs.py IMPORTS FOLDER ARCH. Each has the listed names, empty, under the version that Android gives them."""
import collections, pathlib, subprocess, sys


def read(path):
    """{library: (version, [(name, only weak), ...])}"""
    libraries = collections.OrderedDict()
    for line in pathlib.Path(path).read_text().splitlines():
        if line and not line.startswith("#"):
            head, names = line.split(":")
            library, version = (head.split() + [""])[:2]
            entry = libraries.setdefault(library, (version, []))
            entry[1].extend((name.rstrip("?"), name.endswith("?")) for name in names.split())
    return libraries


def main(imports, folder, arch):
    folder = pathlib.Path(folder)
    for library, (version, names) in read(imports).items():
        source, script = folder / "o" / f"{library}.s", folder / "o" / f"{library}.map"
        lines = []
        for name, _ in names:
            kind = "object" if name == "stderr" else "function"
            lines.append(f".globl {name}\n.type {name}, %{kind}\n{name}: .zero 8\n.size {name}, 8\n")
        source.write_text(".data\n" + "".join(lines))
        command = ["clang-22", f"--target={arch}-linux-android24", "-fuse-ld=lld", "-nostdlib", "-shared",
                   f"-Wl,-soname,{library}", str(source), "-o", str(folder / library)]
        if version:
            script.write_text(version + " { global: " + " ".join(f"{name};" for name, _ in names) + " local: *; };\n")
            command.append(f"-Wl,--version-script={script}")
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
