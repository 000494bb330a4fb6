"""The same pair by every way: table.py CLI_JSON ROWS. Prints the table; fails if rows without a network differ in any digit."""
import json, sys


def main(path, rows):
    result = json.load(open(path))
    table = [("command line, no network", *(repr(result[f"{side}_mm"]["value"]) for side in ("length", "width", "height")))]
    seen = set()
    for line in open(rows):
        name, *cells = (cell.strip() for cell in line.removeprefix("ROW ").split("|"))
        row = (name, *(repr(float(cell)) for cell in cells))  # Java prints some numbers with a digit more
        if row not in seen:
            seen.add(row)
            table.append(row)
    for row in table:
        print("   " + " | ".join(f"{cell:52}" if i == 0 else f"{cell:20}" for i, cell in enumerate(row)))
    plain = {row[1:] for row in table if "network: tract" not in row[0] and "ONNX" not in row[0]}
    print(f"   {len(table)} rows, without a network {len(plain)} different")
    sys.exit(0 if len(plain) == 1 else 1)


if __name__ == "__main__":
    main(*sys.argv[1:])
