within Workshop;
package Components "Of drive trains"
  extends Icons.Package;
end Components;
