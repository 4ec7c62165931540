"""Models with one mistake each: name → (text, line:column, what the message must name)."""

BROKEN = {
    "missing semicolon": (
        """model T
  Real x
equation
  der(x) = -x;
end T;""",
        "2:8",
        "`x`",
    ),
    "unknown variable": (
        """model T
  Real x;
equation
  der(x) = -zz;
end T;""",
        "4:13",
        "'zz'",
    ),
    "unknown class": (
        """model T
  Motor motor;
end T;""",
        "2:3",
        "'Motor'",
    ),
    "unknown member": (
        """model T
  model A
    Real y;
  equation
    y = 1;
  end A;
  A a;
  Real x;
equation
  x = a.z;
end T;""",
        "10:9",
        "'a.z'",
    ),
    "wrong end": (
        """model T
  Real x;
equation
  der(x) = -x;
end U;""",
        "5:5",
        "'U' does not match",
    ),
    "missing equation": (
        """model T
  Real x;
  Real y;
equation
  der(x) = -x;
end T;""",
        "1:1",
        "1 equations for 2 unknowns",
    ),
    "too many equations": (
        """model T
  Real x;
equation
  der(x) = -x;
  x = 2;
end T;""",
        "1:1",
        "2 equations for 1 unknowns",
    ),
    "type of start": (
        """model T
  Real x(start = "a");
equation
  der(x) = 1;
end T;""",
        "2:18",
        "`start`.*Real.*String",
    ),
    "condition not boolean": (
        """model T
  Real x;
equation
  der(x) = if x then 1 else 2;
end T;""",
        "4:15",
        "Boolean.*found `Real`",
    ),
    "boolean plus real": (
        """model T
  Real x;
  Boolean b = true;
equation
  der(x) = x + b;
end T;""",
        "5:16",
        "`\\+` expects Real",
    ),
    "unknown function": (
        """model T
  Real x;
equation
  der(x) = sine(x);
end T;""",
        "4:12",
        "'sine'",
    ),
    "wrong number of arguments": (
        """model T
  Real x;
equation
  der(x) = atan2(x);
end T;""",
        "4:12",
        "expects 2 argument",
    ),
    "subscript out of range": (
        """model T
  Real x[2];
equation
  der(x[1]) = 1;
  der(x[3]) = 1;
end T;""",
        "5:7",
        "subscript 3 for `x`",
    ),
    "array sizes": (
        """model T
  Real x[2];
equation
  der(x) = {1, 2, 3};
end T;""",
        "4:3",
        "expected `\\[2\\]`, found `\\[3\\]`",
    ),
    "unknown modifier": (
        """model T
  extends Twinproof.Plants.Pendulum(
    JJ = 2);
end T;""",
        "3:5",
        "'JJ'.*did you mean J",
    ),
    "unknown attribute": (
        """model T
  Real x(begin = 1);
equation
  der(x) = 1;
end T;""",
        "2:10",
        "`begin`",
    ),
    "connect of different kinds": (
        """model T
  extends Twinproof.Plants.Pendulum;
  Twinproof.Effects.Translational.CoulombFriction f(f_c = 1);
equation
  connect(f.flange, joint.flange);
end T;""",
        "5:3",
        "'f.flange' and 'joint.flange'",
    ),
    "unconnected effect": (
        """model T
  extends Twinproof.Plants.Pendulum;
  Twinproof.Effects.Rotational.CoulombFriction f(tau_c = 1);
end T;""",
        "3:48",
        "nothing is connected to 'f.flange'",
    ),
    "assign parameter": (
        """model T
  parameter Real p = 1;
  Real x;
equation
  der(x) = -x;
  p = 2;
end T;""",
        "1:1",
        "2 equations for 1 unknowns",
    ),
    "duplicate": (
        """model T
  Real x;
  Real x;
equation
  der(x) = -x;
end T;""",
        "3:8",
        "'x' at line 3",
    ),
    "redeclare loses": (
        """package P
  model M
    parameter Real k = 1;
  end M;
  model B
    replaceable model L = M;
    L l;
  end B;
  model T
    extends B(redeclare model L = M(k = 4));
  end T;
end P;""",
        "10:15",
        "write `redeclare B a",
    ),
    "unclosed parenthesis": (
        """model T
  Real x;
equation
  der(x) = -(x;
end T;""",
        "4:15",
        "`;`",
    ),
    "unclosed when": (
        """model T
  Real x;
equation
  der(x) = 1;
  when x > 1 then
    reinit(x, 0);
end T;""",
        "7:1",
        "`end`",
    ),
    "reinit of non state": (
        """model T
  Real x;
  Real y;
equation
  der(x) = 1;
  y = 2 * x;
  when x > 1 then
    reinit(y, 0);
  end when;
end T;""",
        "3:8",
        "y is not a state",
    ),
    "missing then": (
        """model T
  Real x;
equation
  der(x) = if x > 0 1 else 2;
end T;""",
        "4:21",
        "`1`",
    ),
    "cyclic parameters": (
        """model T
  parameter Real a = b;
  parameter Real b = a;
  Real x;
equation
  der(x) = a;
end T;""",
        "2:18",
        "'a'",
    ),
    "final modified": (
        """model T
  model A
    final parameter Real k = 1;
    Real x;
  equation
    der(x) = k;
  end A;
  A a(k = 2);
end T;""",
        "3:26",
        "`k`.*final",
    ),
    "partial instantiated": (
        """model T
  partial model A
    Real x;
  equation
    der(x) = 1;
  end A;
  A a;
end T;""",
        "7:5",
        "'a' instantiates partial",
    ),
    "while": (
        """model T
  function f
    input Real a;
    output Real b;
  algorithm
    b := a;
    while b > 1 loop
      b := b / 2;
    end while;
  end f;
  Real x;
equation
  der(x) = -f(x);
end T;""",
        "2:12",
        "while-loop",
    ),
}
