"""The ledger of sizes: sizes.py OUT LEDGER.json. Prints what was built beside what the ledger says; fails if one differs by more than a
twentieth, so that growth is seen by whoever causes it. REGENERATE=1 writes the ledger anew."""
import json, os, pathlib, sys

FILES = [f"{abi}/{name}" for abi in ("arm64-v8a", "x86_64") for name in ("libboxline_jni.so", "libusb1.0.so")] + ["boxline.aar", "sample-debug.apk"]
MAY_DIFFER = 0.05  # the distribution's compiler is not pinned


def main(out, ledger):
    ledger = pathlib.Path(ledger)
    found = {name: path.stat().st_size for name in FILES if (path := pathlib.Path(out) / name).exists()}
    if os.environ.get("REGENERATE"):
        ledger.write_text(json.dumps(found, indent=2) + "\n")
    kept, bad = json.loads(ledger.read_text()), []
    for name in FILES:
        size, before = found.get(name), kept.get(name)
        print(f"   {name:30} {size or '-':>9} bytes, ledger {before or '-'}")
        if size and (not before or abs(size - before) > MAY_DIFFER * before):
            bad.append(name)
    if bad:
        print(f"   not as in {ledger.name}: {', '.join(bad)}; REGENERATE=1 writes it anew")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
