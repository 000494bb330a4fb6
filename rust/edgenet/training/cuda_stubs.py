"""Makes a CUDA build of torch importable on a machine without CUDA libraries.

The torch wheel links CUDA libraries (cudart, cublas, cudnn, ...) that come as separate packages of more than two
gigabytes and are never used by training on a CPU. For each of them that is missing this script builds a small library
of the same soname, the same symbol version nodes and the same symbols, beside torch's own libraries. Every function
of it answers "no device", so torch finds no GPU and works on the CPU.

    python cuda_stubs.py SITE_PACKAGES

Needs gcc and readelf. Run once after `pip install --no-deps torch`; torch 2.15.0 is what it was written for.
"""

import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

CUDA_LIBRARY = re.compile(
    r"^lib(cudart|cublas|cublasLt|cufft|cufile|cupti|cusolver|cusparse|cusparseLt|cudnn|nccl|nvrtc|nvshmem_host|cuda)\.so"
)
CUDA_SYMBOL = re.compile(r"^(__cuda|cu|nccl|nvrtc|nvshmem|nvml)")
NO_DEVICE = 100  # cudaErrorNoDevice; every other CUDA library also takes non-zero for an error
TEXT_FUNCTIONS = re.compile(r"(GetErrorString|GetErrorName|GetLastError|GetErrorString_v2)$")


def needed_libraries(library: Path) -> list[str]:
    text = subprocess.run(["readelf", "-dW", library], check=True, capture_output=True, text=True).stdout
    return re.findall(r"\(NEEDED\).*\[(.+)\]", text)


def undefined_symbols(library: Path) -> list[tuple[str, str, str]]:
    """(name, type, version node or "") of each symbol that another library must define."""
    text = subprocess.run(["readelf", "-W", "--dyn-syms", library], check=True, capture_output=True, text=True).stdout
    found = []
    for line in text.splitlines():
        fields = line.split()
        if len(fields) >= 8 and fields[6] == "UND":
            name, _, version = fields[7].partition("@")
            found.append((name, fields[3], version.lstrip("@")))
    return found


def source_of(names: dict[str, str]) -> str:
    """C source with one definition for each name; the value is the symbol's ELF type."""
    lines = ['static const char text[] = "this is a stub: no CUDA here";']
    for name, kind in sorted(names.items()):
        if kind == "OBJECT":
            lines.append(f"char {name}[4096];")
        elif TEXT_FUNCTIONS.search(name) and not name.endswith("GetLastError"):
            lines.append(f"const char *{name}(void) {{ return text; }}")
        else:
            lines.append(f"long {name}(void) {{ return {NO_DEVICE}; }}")
    return "\n".join(lines) + "\n"


def build(soname: str, versions: dict[str, dict[str, str]], folder: Path) -> None:
    every = {name: kind for names in versions.values() for name, kind in names.items()}
    with tempfile.TemporaryDirectory() as scratch:
        source, script = Path(scratch, "stub.c"), Path(scratch, "versions")
        source.write_text(source_of(every))
        command = ["gcc", "-shared", "-fPIC", "-O0", "-fno-builtin", "-w", f"-Wl,-soname,{soname}"]
        nodes = {version: names for version, names in versions.items() if version}
        if nodes:
            script.write_text(
                "".join(f"{version} {{ {' '.join(f'{n};' for n in sorted(names))} }};\n" for version, names in nodes.items())
            )
            command.append(f"-Wl,--version-script={script}")
        subprocess.run([*command, "-o", folder / soname, source], check=True)


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = Path(sys.argv[1], "torch", "lib")
    libraries = sorted(p for p in folder.glob("*.so*") if p.is_file() and not CUDA_LIBRARY.match(p.name))
    missing = {n for lib in libraries for n in needed_libraries(lib) if CUDA_LIBRARY.match(n)}
    if not missing:
        sys.exit(f"{folder}: no library here needs CUDA; nothing to do")
    # A version node is usually named after its library; symbols without one may live in any stub.
    stubs: dict[str, dict[str, dict[str, str]]] = {soname: defaultdict(dict) for soname in missing}
    anywhere = "libcudnn.so.9" if "libcudnn.so.9" in missing else sorted(missing)[0]
    for library in libraries:
        wanted = version_owners(library)
        for name, kind, version in undefined_symbols(library):
            version = re.sub(r"\s*\(\d+\)$", "", version)
            owner = wanted.get(version)
            if owner in stubs:
                stubs[owner][version][name] = kind
            elif not version and CUDA_SYMBOL.match(name):
                stubs[anywhere][""][name] = kind
    for soname, versions in sorted(stubs.items()):
        build(soname, versions, folder)
        print(f"stub {soname}: {sum(map(len, versions.values()))} symbols")


def version_owners(library: Path) -> dict[str, str]:
    """Version node -> the library that must define it."""
    text = subprocess.run(["readelf", "-VW", library], check=True, capture_output=True, text=True).stdout
    owners, file = {}, ""
    for line in text.splitlines():
        if found := re.search(r"File: (\S+)", line):
            file = found.group(1)
        elif found := re.search(r"Name: (\S+)\s+Flags", line):
            owners[found.group(1)] = file
    return owners


if __name__ == "__main__":
    main()
