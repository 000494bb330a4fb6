"""The same pair by every way: table.py JSON ROW_FILE... Prints the table; fails if a row differs from the
command line's in any digit or, on another kind of processor, by more than its C library's last digits can do."""
import json, pathlib, sys

OTHER_PROCESSOR_MM = 1e-4  # the network's f32 carry a last digit farther


def main(command_line, *files):
    result = json.loads(pathlib.Path(command_line).read_text())
    due = [repr(result[f"{side}_mm"]["value"]) for side in ("length", "width", "height")]
    table = [("command line", *due)]
    for file in files:
        for line in pathlib.Path(file).read_text().splitlines():
            name, *cells = (cell.strip() for cell in line.removeprefix("ROW ").split("|"))
            table.append((name, *(repr(float(cell)) for cell in cells)))  # Java prints some numbers with a digit more
    for row in table:
        print("   " + " | ".join(f"{cell:52}" if i == 0 else f"{cell:20}" for i, cell in enumerate(row)))
    wrong = []
    for name, *cells in table[1:]:
        differs = max(abs(float(a) - float(b)) for a, b in zip(cells, due))
        print(f"   {name}: differs by {differs:.1e} mm")
        if differs > (OTHER_PROCESSOR_MM if "aarch64" in name else 0):
            wrong.append(name)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
