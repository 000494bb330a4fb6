"""Android's libraries for a Linux machine: shim.py ARCH CC OUT LIBRARY.so...

Reads what the given libraries import, and writes libc.so, libm.so, libdl.so, liblog.so, libandroid.so that have exactly these names. Each
function jumps to shim.c's `bionic_NAME` where the two C libraries differ, else to glibc's own. What cannot be mapped fails here.
"""
import pathlib, re, subprocess, sys
from stubs import read

# Structures or numbers that differ between the two C libraries and are not translated in shim.c.
DIFFERENT = re.compile(r"^(getaddrinfo|sigaction|sem_|setjmp|longjmp|sigset|setlocale|isalpha|_ctype|pthread_sigmask|pthread_spin)")
JUMP = {
    "x86_64": "  jmp *{name}_at(%rip)\n",
    "aarch64": "  adrp x16, {name}_at\n  ldr x16, [x16, :lo12:{name}_at]\n  br x16\n",
}


def imports(library):
    lines = subprocess.run(["llvm-nm-22", "-D", "--undefined-only", library], check=True, capture_output=True, text=True).stdout
    return {line.split()[-1].split("@")[0] for line in lines.splitlines() if line.strip()}


def main(arch, cc, out, *libraries):
    here, out = pathlib.Path(__file__).parent, pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    wanted = set().union(*map(imports, libraries))
    core = (here / "shim.c").read_text()
    own = set(re.findall(r"\bbionic_(\w+)\(", core))
    for name, (version, listed) in read(here / "imports.txt").items():
        names = sorted(n for n, _ in listed if n in wanted)
        wrong = [n for n in names if DIFFERENT.match(n) and n not in own]
        if wrong:
            sys.exit(f"shim: {', '.join(wrong)} differ between the C libraries and have no translation")
        assembly, table = ".text\n", ""
        for n in names:
            if n == "stderr":
                continue
            assembly += f".globl {n}\n.type {n}, %function\n{n}:\n{JUMP[arch].format(name=n)}.size {n}, .-{n}\n"
            table += f'extern void *{n}_at;\n'
        assembly += ".data\n.balign 8\n" + "".join(f".globl {n}_at\n.hidden {n}_at\n{n}_at: .quad 0\n" for n in names if n != "stderr")
        assembly += '.section .note.GNU-stack,"",%progbits\n'
        rows = "".join(f'  {{"{n}", &{n}_at}},\n' for n in names if n != "stderr")
        source = f"{table}struct row {{ const char *name; void **at; }};\nextern void shim_fill(const struct row *, int);\n"
        source += f"static const struct row rows[] = {{\n{rows}  {{0, 0}}}};\n"
        source += f"__attribute__((constructor)) static void fill(void) {{ shim_fill(rows, {len(names) - ('stderr' in names)}); }}\n"
        if "stderr" in names:
            source += "void *stderr;\n"  # a FILE* of glibc, set by shim_fill's caller below
            source += 'extern void *shim_stderr(void);\n__attribute__((constructor)) static void err(void) { stderr = shim_stderr(); }\n'
        (out / f"{name}.S").write_text(assembly)
        (out / f"{name}.c").write_text(source)
        script = f"{version} {{ global: {' '.join(n + ';' for n in names)} local: *; }};" if version and names else "{ global: *; };"
        (out / f"{name}.map").write_text(script)
    run = lambda *command: subprocess.run([*map(str, command)], check=True)
    # The core is bound to glibc's names, so it is a library of its own that has none of Android's.
    run(cc, "-O1", "-shared", "-fPIC", here / "shim.c", "-o", out / "libshimcore.so", "-ldl", "-lpthread")
    for name in read(here / "imports.txt"):
        run(cc, "-O1", "-shared", "-fPIC", "-nostdlib", out / f"{name}.c", out / f"{name}.S", "-o", out / name, f"-Wl,-soname,{name}",
            f"-Wl,--version-script={out / (name + '.map')}", "-L", out, "-lshimcore", "-Wl,-rpath,$ORIGIN")


if __name__ == "__main__":
    main(*sys.argv[1:])
