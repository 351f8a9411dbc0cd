"""Elements of a model that ask for another file, for code, or for more than there is."""

from __future__ import annotations

__all__ = ["ELEMENTS", "SECRET", "WHOLE", "YAML"]

SECRET = "SECRET"
"""Name that only the files outside the folder carry: to see it is to have read one."""

_PLACES = (
    *("../secret/secret.xml", "..\\secret\\secret.xml", "sub\\..\\..\\secret\\secret.xml"),
    *("sub/../../secret/secret.xml", "link.xml", "sub/link.xml", "{secret}/secret.xml"),
    *("file:///etc/passwd", "/etc/passwd", "http://127.0.0.1:9/a.xml", "pipe.xml", "/dev/zero"),
    *("package://../secret/secret.xml", "file://../secret/secret.xml", "\\\\server\\share\\a.xml"),
)
ELEMENTS: tuple[str, ...] = (
    *(f'<include file="{place}"/>' for place in _PLACES),
    *(f'<asset><mesh name="m" file="{p.replace("xml", "stl")}"/></asset>' for p in _PLACES),
    *(f'<asset><model name="m" file="{place}"/></asset>' for place in _PLACES),
    *(f'<asset><hfield name="h" size="1 1 1 1" file="{p}"/></asset>' for p in _PLACES[:6]),
    *(f'<asset><texture name="t" type="2d" file="{p}"/></asset>' for p in _PLACES[:6]),
    *(f'<asset><texture name="t" type="cube" fileup="{p}"/></asset>' for p in _PLACES[:3]),
    *(f'<deformable><skin name="s" file="{p}"/></deformable>' for p in _PLACES[:3]),
    '<compiler meshdir="../secret"/><asset><mesh name="m" file="secret.stl"/></asset>',
    '<compiler assetdir="{secret}"/><asset><mesh name="m" file="secret.stl"/></asset>',
    '<compiler meshdir="sub"/><include file="part.xml"/>',
    '<asset xmlns="x"><include file="inner.xml"/></asset>',
    '<extension><plugin plugin="../evil.so"/></extension>',
    '<extension><plugin plugin="mujoco.sdf.torus"><instance name="a"/></plugin></extension>',
    '<worldbody><replicate count="100000000"><site/></replicate></worldbody>',
    '<worldbody><replicate count="9999"><replicate count="9999"><site/></replicate></replicate>'
    "</worldbody>",
    '<worldbody><flexcomp name="f" type="grid" count="999 999 999" spacing=".1 .1 .1"/>'
    "</worldbody>",
    '<worldbody><camera name="c" resolution="99999 99999"/></worldbody>',
    "<worldbody>" + "<body>" * 600 + "</body>" * 600 + "</worldbody>",
    '<asset><texture type="2d" name="t" builtin="flat" width="99999" height="99999"/></asset>',
    '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
    '<asset><mesh name="m" builtin="sphere" params="30"/></asset>',
    '<asset><mesh name="m" builtin="sphere" params="1000000"/></asset>',
    '<asset><mesh name="m" builtin="supertorus" params="99999 1 1 1 1"/></asset>',
    '<size memory="99999G"/>',
    '<size nkey="999999999"/>',
    '<size nuserdata="2000000000"/>',
    '<size nuser_body="999999999"/>',
    '<custom><numeric name="n" size="2000000000"/></custom>',
    '<option timestep="0"/>',
    '<option timestep="-1" gravity="nan nan nan"/>',
    '<keyframe><key qpos="' + "1 " * 5000 + '"/></keyframe>',
    '<statistic meansize="-1"/>',
    '<compiler eulerseq="xxx"/>',
    '<default class="a"><default class="a"/></default>',
)
"""Put in before the end of a model; ``{secret}`` becomes the full path of a folder outside."""

WHOLE: tuple[str, ...] = (
    '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">'
    + "".join(f'<!ENTITY c{k} "{"&b;" * 10}">' for k in range(9))
    + "]><mujoco model='&c8;'/>",
    '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>',
    '<?xml version="1.0" encoding="utf-7"?><mujoco/>',
    '<?xml-stylesheet href="http://127.0.0.1:9/a.xsl"?><mujoco/>',
    '<mujoco xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="/etc/passwd"/></mujoco>',
    "<mujoco>" * 100_000,
    "<robot name='r'><link name='a'/><joint name='j' type='revolute'><parent link='a'/>"
    "<child link='a'/></joint></robot>",
    "<robot name='r'>"
    + "".join(f"<link name='l{k}'/>" for k in range(300))
    + "".join(
        f"<joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/></joint>"
        for k in range(299)
    )
    + "</robot>",
)
"""Whole files."""


def _laughs(levels: int = 12) -> str:
    """Lists of lists of lists, each nine times the one before: more words than memory holds."""
    lines = ["a: &b0 [x,x,x,x,x,x,x,x,x]"]
    for k in range(levels):
        lines.append(f"b{k + 1}: &b{k + 1} [{','.join([f'*b{k}'] * 9)}]")
    return "\n".join([*lines, f"default: *b{levels}"])


YAML: tuple[str, ...] = (
    "default: !!python/object/apply:os.system ['touch EXECUTED']",
    "default: !!python/object/new:subprocess.Popen [['touch', 'EXECUTED']]",
    "default: {policy_kwargs: \"__import__('os').system('touch EXECUTED')\"}",
    'default: {policy_kwargs: "dict(activation_fn=nn.__class__)"}',
    "default: {learning_rate: \"lin___import__('os')\"}",
    _laughs(),
    "default: &d {n_envs: *d}",
    "default: {n_envs: " + "9" * 5000 + "}",
    "default: {n_steps: [1, 2]}\ndefault: 3",
    "default: " + "[" * 5000,
    "default: {n_envs: 2024-01-01, policy: !!binary aGVsbG8=}",
)
"""Files of hyperparameters that ask for code, or for all memory."""
