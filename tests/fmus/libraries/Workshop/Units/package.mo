within Workshop;
package Units "Types"
  extends Icons.Package;
  package SI "Of the SI"
    type Angle = Real(final quantity="Angle", final unit="rad", displayUnit="deg");
    type AngularVelocity = Real(final quantity="AngularVelocity", final unit="rad/s");
    type AngularAcceleration = Real(final quantity="AngularAcceleration", final unit="rad/s2");
    type Acceleration = Real(final quantity="Acceleration", final unit="m/s2");
    type Torque = Real(final quantity="Torque", final unit="N.m");
    type MomentOfInertia = Real(final quantity="MomentOfInertia", final unit="kg.m2");
    type Inertia = MomentOfInertia;
    type RotationalSpringConstant = Real(final unit="N.m/rad");
    type RotationalDampingConstant = Real(final unit="N.m.s/rad");
    type Time = Real(final quantity="Time", final unit="s");
    type Frequency = Real(final quantity="Frequency", final unit="Hz");
  end SI;
end Units;
