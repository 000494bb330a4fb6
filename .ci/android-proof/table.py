"""The same pair by every way: table.py JSON_WITHOUT_NETWORK JSON_WITH_NETWORK ROW_FILE... Prints the table; fails if a row differs from the
command line's in any digit or, on another kind of processor, by more than its C library's last digits can do."""
import json, pathlib, sys

OTHER_PROCESSOR_MM = {False: 1e-8, True: 1e-4}  # without and with the network, whose f32 carry a last digit farther


def main(without, network, *files):
    def command_line(path):
        result = json.loads(pathlib.Path(path).read_text())
        return [repr(result[f"{side}_mm"]["value"]) for side in ("length", "width", "height")]

    due = {False: command_line(without), True: command_line(network)}
    table = [("command line, no network", *due[False]), ("command line", *due[True])]
    for file in files:
        for line in pathlib.Path(file).read_text().splitlines():
            name, *cells = (cell.strip() for cell in line.removeprefix("ROW ").split("|"))
            table.append((name, *(repr(float(cell)) for cell in cells)))  # Java prints some numbers with a digit more
    for row in table:
        print("   " + " | ".join(f"{cell:52}" if i == 0 else f"{cell:20}" for i, cell in enumerate(row)))
    wrong = []
    for name, *cells in table[2:]:
        has_network = "network: none" not in name
        differs = max(abs(float(a) - float(b)) for a, b in zip(cells, due[has_network]))
        print(f"   {name}: differs by {differs:.1e} mm")
        if differs > (OTHER_PROCESSOR_MM[has_network] if "aarch64" in name else 0):
            wrong.append(name)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
