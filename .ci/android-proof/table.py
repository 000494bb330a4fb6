"""The same pair by every way: table.py CLI_JSON ROW_FILE... Prints the table; fails if rows without a network differ in
any digit, or, on another kind of processor, by more than 1e-8 mm."""
import json, pathlib, sys


def main(path, *files):
    result = json.loads(pathlib.Path(path).read_text())
    table = [("command line, no network", *(repr(result[f"{side}_mm"]["value"]) for side in ("length", "width", "height")))]
    for file in files:
        for line in pathlib.Path(file).read_text().splitlines():
            name, *cells = (cell.strip() for cell in line.removeprefix("ROW ").split("|"))
            table.append((name, *(repr(float(cell)) for cell in cells)))  # Java prints some numbers with a digit more
    for row in table:
        print("   " + " | ".join(f"{cell:52}" if i == 0 else f"{cell:20}" for i, cell in enumerate(row)))
    first = table[0][1:]
    wrong = []
    for name, *cells in table[1:]:
        if "network: none" in name:
            differs = max(abs(float(a) - float(b)) for a, b in zip(cells, first))
            print(f"   {name}: differs by {differs:.1e} mm")
            if differs > (1e-8 if "aarch64" in name else 0):
                wrong.append(name)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
