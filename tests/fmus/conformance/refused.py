"""What is refused: construct → (a model that has it, part of the message)."""

REFUSED = {
    "while-loop in a function": (
        "model T function f input Real a; output Real b; algorithm b := a; while b > 1 loop"
        " b := b / 2; end while; end f; Real x; equation der(x) = -f(x); end T;",
        "while-loop",
    ),
    "external function": (
        'model T function f input Real a; output Real b; external "C"; end f; Real x;'
        " equation der(x) = -f(x); end T;",
        "external functions",
    ),
    "recursive function": (
        "model T function f input Real a; output Real b;"
        " algorithm b := if a > 1 then f(a - 1) else a; end f;"
        " Real x; equation der(x) = -f(x); end T;",
        "recursive function",
    ),
    "String variables": (
        'model T String s; Real x; equation der(x) = -x; s = if x > 1 then "a" else "b"; end T;',
        "string variable 's'",
    ),
    "redeclare of a class with a modifier, within a modifier": (
        "model T model M parameter Real k = 1; end M; model B replaceable model L = M; L l;"
        " end B; B b(redeclare model L = M(k = 4)); end T;",
        "would be lost",
    ),
    "initial() within a longer condition": (
        "model T Real x; discrete Real d; equation der(x) = 1;"
        " when initial() and x > 0 then d = 1; end when; end T;",
        r"initial\(\) within",
    ),
    "terminal()": (
        "model T Real x; discrete Real d; equation der(x) = 1;"
        " when terminal() then d = 1; end when; end T;",
        "terminal",
    ),
    "clocked equations (Clock, hold, previous)": (
        "model T Real x(start = 0); Real u; equation der(x) = hold(u);"
        " u = previous(u) + sample(x, Clock(0.1)); end T;",
        "clocks, hold and previous",
    ),
    "stream connectors": (
        "model T connector C Real p; flow Real m; stream Real h; end C; C c; Real x;"
        " equation der(x) = inStream(c.h); c.p = 1; c.h = 2; end T;",
        "stream connectors",
    ),
    "spatialDistribution": (
        "model T Real x; Real a; Real b; equation der(x) = 1;"
        " (a, b) = spatialDistribution(x, 0, x, true, {0, 1}, {0, 0}); end T;",
        "spatialDistribution",
    ),
    "reinit of a whole array": (
        "model T Real x[2](start = {1, 2}); equation der(x) = -x;"
        " when x[1] < 0.5 then reinit(x, {1, 1}); end when; end T;",
        "reinit of a whole array",
    ),
    "when within a for-equation": (
        "model T Real x[2]; Integer n[2]; equation for i in 1:2 loop der(x[i]) = i;"
        " when x[i] > 0.5 then n[i] = pre(n[i]) + 1; end when; end for; end T;",
        "when within a for-equation",
    ),
    "algorithm section with a for-loop, outside of a function": (
        "model T Real s; algorithm s := 0; for i in 1:3 loop s := s + i * time; end for; end T;",
        "algorithm section with loops",
    ),
    "assert with AssertionLevel.warning": (
        "model T Real x(start = 0); equation der(x) = 1;"
        ' assert(x < 0.5, "hm", AssertionLevel.warning); end T;',
        "AssertionLevel.warning",
    ),
    "pre of a continuous variable outside of when": (
        "model T Real x(start = 0); Real y; equation der(x) = 1; y = pre(x); end T;",
        "continuous variable",
    ),
    "sample with an interval that changes": (
        "model T Real x; discrete Real d; input Real u; equation der(x) = 1;"
        " when sample(0, u) then d = 1; end when; end T;",
        "not parameter-evaluable",
    ),
    "constraint that asks for the derivative of an input": (
        "model T input Real u; Real x; Real v; equation der(x) = v; x = u; end T;",
        "derivative of the input 'u'",
    ),
    "equations that contradict each other": (
        "model T Real x; Real y; Real z; equation der(x) = 1; x = 3 * time; y + z = 1; end T;",
        "no finite index",
    ),
}
