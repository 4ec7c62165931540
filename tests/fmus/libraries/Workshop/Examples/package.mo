within Workshop;
package Examples "Models that can be simulated"
end Examples;
