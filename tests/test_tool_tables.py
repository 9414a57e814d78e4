"""Tool tables of catalogues and CAM systems: ISO 13399 (.p21, GTC package), MTConnect, FreeCAD; cutter_file."""

import io
import json
import zipfile
from pathlib import Path

import pytest

from compplan.errors import InputError
from compplan.job.job import check_job
from compplan.job.operations import split_job
from compplan.job.tool_tables import read_tool_library, take_cutter

#: A corner-radius mill of 12 mm as its maker would write it: own words, the entities of the standard.
P21 = """ISO-10303-21;
HEADER;
FILE_SCHEMA(('CUTTING_TOOL_SCHEMA_ARM'));
ENDSEC;
DATA;
#1=STRING_WITH_LANGUAGE('Torus; Schaftfr#1 ''kurz''',#9);
#2=MULTI_LANGUAGE_STRING((),#1);
#3=ITEM(#2,'4711-12',#2);
#4=SPECIFIC_ITEM_CLASSIFICATION((#3),'tool item',$);
#5=UNIT('mm');
#6=NUMERICAL_VALUE('DC',$,#5,'12.0'); /* #7=NUMERICAL_VALUE('DC',$,#5,'99.0'); */
#8=NUMERICAL_VALUE('RE', $, #5, '0.5');
#10=NUMERICAL_VALUE('APMX',$,#5,'26.0');
#11=NUMERICAL_VALUE('LCF',$,#5,'30.0');
#12=NUMERICAL_VALUE('ZEFP',$,$,'4');
#13=NUMERICAL_VALUE('LF',$,#5,'83.0');
#14=NUMERICAL_VALUE('WT',$,#15,'0.09');
#15=UNIT('kg');
#16=STRING_VALUE('GRADE','X10');
ENDSEC;
END-ISO-10303-21;
"""
#: A drill of a quarter of an inch.
DRILL = """ISO-10303-21;
DATA;
#1=ITEM($,'D-025',$);#2=UNIT('in');#3=UNIT('deg');
#4=NUMERICAL_VALUE('DC',$,#2,'0.25');
#5=NUMERICAL_VALUE('SIG',$,#3,140.);
#6=NUMERICAL_VALUE('LCF',$,#2,'1.5');
#7=NUMERICAL_VALUE('NOF',$,$,'2');
ENDSEC;
END-ISO-10303-21;
"""
MTCONNECT = """<?xml version="1.0"?>
<MTConnectAssets xmlns="urn:mtconnect.org:MTConnectAssets:1.8"><Assets>
<CuttingTool assetId="a" serialNumber="1" toolId="ballnose 6"><CuttingToolLifeCycle>
<ProgramToolNumber>7</ProgramToolNumber><Measurements>
<FunctionalLength code="LF" nominal="120">119.8</FunctionalLength><CuttingDiameterMax nominal="6"/>
<DepthOfCutMax code="APMX">14</DepthOfCutMax></Measurements></CuttingToolLifeCycle></CuttingTool>
</Assets></MTConnectAssets>"""
BIT = {"version": 2, "name": "bull", "shape": "bullnose.fcstd", "parameter": {
    "Diameter": "0.5 in", "CornerRadius": "1,00 mm", "CuttingEdgeHeight": "25.0000 mm", "Flutes": 3}}  # fmt: skip


def pack(*members: tuple[str, bytes]) -> bytes:
    """Return a zip archive."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


def test_a_file_of_iso_13399_says_the_cutter_by_its_codes(tmp_path: Path) -> None:
    (tmp_path / "mill.p21").write_text(P21, encoding="utf-8")
    (tool,) = read_tool_library(tmp_path / "mill.p21")
    assert (tool.name, tool.kind, tool.number, tool.length_mm, tool.mass_kg) == ("4711-12", "mill", None, None, 0.09)
    assert (tool.diameter_mm, tool.corner_radius_mm, tool.teeth, tool.flute_mm) == (12.0, 0.5, 4, 26.0)
    (tmp_path / "drill.p21").write_text(DRILL, encoding="utf-8")
    (drill,) = read_tool_library(tmp_path / "drill.p21")
    assert (drill.kind, drill.point_deg, drill.teeth) == ("drill", 140.0, 2)
    assert (drill.diameter_mm, drill.flute_mm) == pytest.approx((6.35, 38.1))


@pytest.mark.parametrize("nested", [False, True])
def test_a_gtc_package_holds_a_tool_in_each_of_its_product_files(tmp_path: Path, nested: bool) -> None:
    members = [("product_data_files/A.p21", P21.encode()), ("product_data_files/B.p21", DRILL.encode())]
    if nested:  # packages of 2017 zip each file once more
        members = [(f"Documents/{name}.zip", pack((name, content))) for name, content in members]
    package = pack(("package_assortment.xml", b"<package_assortment/>"), ("models/A.stp", b"ISO-10303-21;"), *members)
    (tmp_path / "gtc.zip").write_bytes(package)
    tools = read_tool_library(tmp_path / "gtc.zip")
    assert [tool.name for tool in tools] == ["4711-12", "D-025"]
    assert take_cutter(tools, "d-025", "gtc.zip").kind == "drill"
    with pytest.raises(InputError, match="holds 2 tools; write cutter_name, one of '4711-12', 'D-025'"):
        take_cutter(tools, None, "gtc.zip")


def test_an_asset_of_mtconnect_says_number_length_and_cutter(tmp_path: Path) -> None:
    (tmp_path / "assets.xml").write_text(MTCONNECT, encoding="utf-8")
    (tool,) = read_tool_library(tmp_path / "assets.xml")
    assert (tool.number, tool.name, tool.length_mm, tool.kind) == (7, "ballnose 6", 119.8, "mill")
    assert (tool.diameter_mm, tool.corner_radius_mm, tool.flute_mm) == (6.0, 3.0, 14.0)


def test_bits_of_freecad_are_found_beside_their_library(tmp_path: Path) -> None:
    for folder in ("Bit", "Library"):
        (tmp_path / folder).mkdir()
    (tmp_path / "Bit" / "bull.fctb").write_text(json.dumps(BIT), encoding="utf-8")
    library = tmp_path / "Library" / "mine.fctl"
    library.write_text(json.dumps({"version": 1, "tools": [{"nr": 4, "path": "bull.fctb"}]}), encoding="utf-8")
    (tool,) = read_tool_library(library)
    assert (tool.number, tool.name, tool.kind, tool.teeth) == (4, "bull", "mill", 3)
    assert (tool.diameter_mm, tool.corner_radius_mm, tool.flute_mm) == pytest.approx((12.7, 1.0, 25.0))
    library.write_text(json.dumps({"tools": [{"nr": 4, "path": "gone.fctb"}]}), encoding="utf-8")
    with pytest.raises(InputError, match=r"names the bit 'gone.fctb', which is neither beside it nor in ../Bit"):
        read_tool_library(library)


@pytest.mark.parametrize(("name", "text", "said"), [
    ("a.p21", P21.replace("'DC'", "'DX'"), "states no cutting diameter .DC.; it states APMX, DX, LCF"),
    ("a.p21", P21.replace("#8=NUMERICAL_VALUE('RE'", "#8=NUMERICAL_VALUE('DC'"), "states DC as 12 and as 0.5"),
    ("a.p21", P21.replace("'12.0'", "'wide'"), "DC of the tool '4711-12' is 'wide', expected a number"),
    ("a.p21", P21.replace("UNIT('mm')", "UNIT('ell')"), "APMX of the tool '4711-12' states no unit"),
    ("a.p21", P21.replace("ITEM(", "ITEMS("), "holds no ITEM"),
    ("a.p21", P21.replace("END-ISO", "EN-ISO"), "holds no tool"),
    ("a.xml", MTCONNECT.replace(">7<", ">x<"), "ProgramToolNumber is 'x', expected a number"),
    ("a.fctb", json.dumps(BIT).replace("0.5 in", "0.5"), "Diameter of 'bull' states no unit"),
    ("a.fctb", json.dumps(BIT)[:-3], "is no tool bit: expected JSON"),
])  # fmt: skip
def test_files_that_do_not_say_a_cutter_are_refused_in_words(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_tool_library(tmp_path / name)


def make(tmp_path: Path, process: dict, **tool):
    return check_job({"schema": 1, "robot": "kuka_kr16_2", "toolpath": "x.csv", "process": process,
                      "tool": {"position_mm": [0.0, 0.0, 150.0], **tool}}, tmp_path / "job.toml")  # fmt: skip


def test_the_tool_of_a_job_takes_its_cutter_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "mill.p21").write_text(P21, encoding="utf-8")
    process = {"model": "end_mill", "spindle_rpm": 9000.0, "material": "al6082_t6"}
    found = make(tmp_path, process, cutter_file="mill.p21").process
    assert (found.diameter_mm, found.corner_radius_mm, found.teeth, found.flute_mm) == (12.0, 0.5, 4, 26.0)
    assert make(tmp_path, {**process, "diameter_mm": 12.0, "teeth": 4}, cutter_file="mill.p21").process == found
    with pytest.raises(InputError, match=r"job.toml: tool.cutter_file: says diameter_mm = 12, and \[process\] 10"):
        make(tmp_path, {**process, "diameter_mm": 10.0}, cutter_file="mill.p21")
    with pytest.raises(InputError, match=r"is a mill, and process.model is 'drill'"):
        make(tmp_path, {**process, "model": "drill"}, cutter_file="mill.p21")
    with pytest.raises(InputError, match=r"gone.p21: no such file"):
        make(tmp_path, process, cutter_file="gone.p21")


def test_each_tool_of_a_cam_file_takes_its_cutter_from_its_own_file(tmp_path: Path) -> None:
    (tmp_path / "gtc.zip").write_bytes(pack(("A.p21", P21.encode()), ("B.p21", DRILL.encode())))
    (tmp_path / "part.nc").write_text("G21 G90\nT1 M6\nS9000 M3\nG0 X0 Y0 Z5\nG1 Z-1 F500\nX40\nG0 Z5\n"
                                      "T2 M6\nG0 X10\nG1 Z-4 F200\nG0 Z5\nM30\n")  # fmt: skip
    process = {"model": "end_mill", "diameter_mm": 20.0, "spindle_rpm": 9000.0, "material": "al6082_t6"}
    tools = [{"number": 1, "position_mm": [0.0, 0.0, 150.0], "cutter_file": "gtc.zip", "cutter_name": "4711-12"},
             {"number": 2, "position_mm": [0.0, 0.0, 160.0], "cutter_file": "gtc.zip", "cutter_name": "D-025"}]
    job = check_job({"schema": 1, "robot": "kuka_kr16_2", "toolpath": "part.nc", "process": process, "tool": tools},
                    tmp_path / "job.toml")  # fmt: skip
    mill, drill = split_job(job)
    assert (mill.process.model, mill.process.diameter_mm, mill.process.teeth) == ("end_mill", 12.0, 4)
    assert (drill.process.model, drill.process.point_deg) == ("drill", 140.0)
    assert drill.process.diameter_mm == pytest.approx(6.35)
    tools[1]["process"] = {"diameter_mm": 6.0}
    with pytest.raises(InputError, match=r"job.toml: tool\[1\].cutter_file: says diameter_mm = 6.35"):
        split_job(check_job({**job.data, "tool": tools}, job.file))
