"""The same pair by every way: table.py CLI_JSON ROW_FILE... Prints the table; fails if rows without a network differ in any digit."""
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
    plain = {row[1:] for row in table if "network: none" in row[0] or "no network" in row[0]}
    print(f"   {len(table)} rows, without a network {len(plain)} different")
    sys.exit(0 if len(plain) == 1 else 1)


if __name__ == "__main__":
    main(*sys.argv[1:])
