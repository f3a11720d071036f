"""Hostile names, each of which would have an effect if it were not treated as text."""

HOSTILE = [
    "<img src=x onerror=alert(1)>",
    '"><script>alert(1)</script>',
    "[red]bold[/red] [link=file:///etc/passwd]x[/link]",
    "\x1b[31mred\x1b]8;;http://x\x07link\x1b]8;;\x07",
    "a|b\nc\r\nd",
    "[text](javascript:alert(1)) ![i](x)",
    r"\input{/etc/passwd} $x_1$ & % # ~ ^ { } \end{tabular}",
    "=HYPERLINK(0)",
    "\uff1dHYPERLINK(0)",
    "@SUM(1+1)*cmd|' /C calc'!A0",
    "a\u202egnp.exe",
    "漢字 emoji 🙂 Ωß",
    "",
    "x" * 500,
    "`code` **b** ~~s~~ $$m$$",
    "--''``\"",
]
